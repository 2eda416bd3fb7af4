//! Parallel loops that stay on the calling thread for small inputs, where waking other threads would take longer than the work.

use std::cmp::Ordering;
use std::ops::Range;

use rayon::prelude::*;

/// Number of cheap items below which the calling thread does all work.
const FEW_CHEAP_ITEMS: usize = 4096;
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

/// Number of cheap items in a chunk, the work of one thread at a time.
const CHUNK: usize = 1 << 15;

/// The values of a function for consecutive ranges that cover 0 to `count`, in order, computed in parallel. The ranges
/// depend on `count` only.
pub fn map_chunks<T: Send>(count: usize, value: impl Fn(Range<usize>) -> T + Sync + Send) -> Vec<T> {
    map(count.div_ceil(CHUNK), 2, |chunk| value(chunk * CHUNK..count.min((chunk + 1) * CHUNK)))
}

/// The values of a cheap function for 0 to `count`, in order, computed in parallel if they are many.
pub fn map_cheap<T: Send>(count: usize, value: impl Fn(usize) -> T + Sync + Send) -> Vec<T> {
    map(count, CHUNK, value)
}

/// The two values of a cheap function for 0 to `count`, each in order, computed in parallel if they are many.
pub fn map_pairs<A: Send, B: Send>(count: usize, values: impl Fn(usize) -> (A, B) + Sync + Send) -> (Vec<A>, Vec<B>) {
    if count < CHUNK {
        return (0..count).map(values).unzip();
    }
    let (mut a, mut b) = (Vec::new(), Vec::new());
    (0..count).into_par_iter().map(values).unzip_into_vecs(&mut a, &mut b);
    (a, b)
}

/// The values that a cheap function has for some of 0 to `count`, in order, computed in parallel if they are many.
pub fn filter_map<T: Send>(count: usize, value: impl Fn(usize) -> Option<T> + Sync + Send) -> Vec<T> {
    map_chunks(count, |range| range.filter_map(&value).collect::<Vec<T>>()).into_iter().flatten().collect()
}

/// The number of the items 0 to `count` for which a cheap test holds.
pub fn count(count: usize, holds: impl Fn(usize) -> bool + Sync + Send) -> u64 {
    map_chunks(count, |range| range.filter(|&item| holds(item)).count() as u64).into_iter().sum()
}

/// Calls a function with each item, in parallel unless there is only one.
pub fn for_each<T: Send>(items: Vec<T>, act: impl Fn(T) + Sync + Send) {
    if items.len() < 2 { items.into_iter().for_each(act) } else { items.into_par_iter().for_each(act) }
}

/// Sorts in parallel if the items are many. Items that compare as equal must be equal in every respect.
pub fn sort_by<T: Send>(items: &mut [T], compare: &(impl Fn(&T, &T) -> Ordering + Sync)) {
    if items.len() < CHUNK {
        return items.sort_unstable_by(compare);
    }
    let (left, right) = items.split_at_mut(items.len() / 2);
    rayon::join(|| sort_by(left, compare), || sort_by(right, compare));
    // The standard library's stable sort merges two sorted runs in linear time.
    items.sort_by(compare);
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
    fn chunks_cover_all_items_in_order() {
        for count in [0, 1, CHUNK, CHUNK + 1, 3 * CHUNK] {
            assert!(map_chunks(count, |range| range).into_iter().flatten().eq(0..count), "{count}");
            assert_eq!(super::count(count, |item| item % 2 == 1), count as u64 / 2);
            let halves = filter_map(count, |item| (item % 2 == 1).then_some(item / 2));
            assert!(halves.into_iter().eq(0..count / 2), "{count}");
        }
    }

    #[test]
    fn many_items_are_sorted_like_few() {
        let mut items: Vec<u64> = (0..5 * CHUNK as u64).map(|i| i.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 40).collect();
        let mut expected = items.clone();
        expected.sort_unstable();
        sort_by(&mut items, &u64::cmp);
        assert!(items == expected);
    }

    #[test]
    fn few_items_stay_on_the_calling_thread() {
        let here = std::thread::current().id();
        assert!(map(10, 11, |_| std::thread::current().id()).iter().all(|&id| id == here));
    }
}
