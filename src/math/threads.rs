//! Parallel loops that stay on the calling thread for small inputs, where waking other threads would take longer than the work.

use rayon::prelude::*;

/// Number of cheap items below which the calling thread does all work.
pub const FEW_CHEAP_ITEMS: usize = 4096;
/// Number of items with a search in a tree each below which the calling thread does all work.
pub const FEW_SEARCHES: usize = 64;

/// Runs two functions over `items` cheap items each, in parallel unless the items are few.
pub fn join<A: Send, B: Send>(items: usize, a: impl FnOnce() -> A + Send, b: impl FnOnce() -> B + Send) -> (A, B) {
    if items < FEW_CHEAP_ITEMS { (a(), b()) } else { rayon::join(a, b) }
}

/// The values of a function for 0 to `count`, in order, computed in parallel from `few` items on.
pub fn map<T: Send>(count: usize, few: usize, value: impl Fn(usize) -> T + Sync + Send) -> Vec<T> {
    if count < few { (0..count).map(value).collect() } else { (0..count).into_par_iter().map(value).collect() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn few_and_many_items_give_the_same_values_in_order() {
        let square = |i: usize| i * i;
        let expected: Vec<usize> = (0..1000).map(square).collect();
        assert_eq!(map(1000, 2000, square), expected);
        assert_eq!(map(1000, 10, square), expected);
        assert_eq!(join(1, || 1, || 2), (1, 2));
        assert_eq!(join(1_000_000, || 1, || 2), (1, 2));
    }

    #[test]
    fn few_items_stay_on_the_calling_thread() {
        let here = std::thread::current().id();
        assert!(map(10, 11, |_| std::thread::current().id()).iter().all(|&id| id == here));
    }
}
