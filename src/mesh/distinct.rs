//! Numbers different positions in linear time for ordinary meshes, and in O(n log n) for positions crafted to collide in the
//! hash table.

use std::collections::BTreeMap;
use std::marker::PhantomData;

use glam::DVec3;

use crate::math::threads;

/// An empty slot of the hash table.
pub(super) const EMPTY: u32 = u32::MAX;
/// Average number of slots that one lookup may probe. At a load of 3/4, linear probing visits 7.5 slots for an absent
/// position and far fewer for a present one (Knuth, The Art of Computer Programming 3, 6.4).
const PROBES_PER_LOOKUP: u64 = 24;
/// Additional probes, so that a few clusters in a small mesh do not matter.
const BASE_PROBES: u64 = 1 << 16;

/// Faces whose vertices are looked up as a batch. Starting the lookups together overlaps their memory latency.
pub(super) const BATCH: usize = 64;

/// Number of parts into which many positions are divided by their hashes.
const SHARDS: usize = 16;
/// Number of positions below which one thread compares all.
const FEW_POSITIONS: usize = 1 << 16;

/// A key that is equal exactly for equal positions. Adding 0.0 turns -0.0 into 0.0.
#[must_use]
pub fn position_key(p: DVec3) -> [u64; 3] {
    p.to_array().map(|x| (x + 0.0).to_bits())
}

/// When two positions are equal.
pub(super) trait Equality: Send + Sync {
    /// A key that is equal exactly for equal positions.
    fn key(position: DVec3) -> [u64; 3];
}

/// Positions are equal if their coordinates are equal numbers: -0.0 equals 0.0.
pub(super) struct Number;

impl Equality for Number {
    fn key(position: DVec3) -> [u64; 3] {
        position_key(position)
    }
}

/// Positions are equal if their coordinates have the same bits, so that a file keeps each of its coordinates.
pub(super) struct Bits;

impl Equality for Bits {
    fn key(position: DVec3) -> [u64; 3] {
        position.to_array().map(f64::to_bits)
    }
}

/// Different positions, numbered in the order in which they were added.
pub(super) struct Distinct<E> {
    index: Index<E>,
    positions: Vec<DVec3>,
}

impl<E: Equality> Distinct<E> {
    /// An empty list, with room for about as many positions.
    pub fn with_capacity_for(positions: usize) -> Self {
        Self { index: Index::Hash(Table::with_capacity_for(positions)), positions: Vec::new() }
    }

    /// The position of each number.
    pub fn into_positions(mut self) -> Vec<DVec3> {
        self.positions.shrink_to_fit();
        self.positions
    }

    /// Calls `take` with the number of each position, in order. Adds positions that are new.
    pub fn number_all(&mut self, positions: impl Iterator<Item = DVec3>, mut take: impl FnMut(u32)) {
        let mut batch = [DVec3::ZERO; 3 * BATCH];
        let mut positions = positions.peekable();
        while positions.peek().is_some() {
            let mut count = 0;
            for (slot, position) in batch.iter_mut().zip(&mut positions) {
                *slot = position;
                count += 1;
            }
            let batch = &batch[..count];
            let mut guesses = [EMPTY; 3 * BATCH];
            self.guess(batch.iter().copied(), &mut guesses);
            for (&position, &guess) in batch.iter().zip(&guesses) {
                take(self.number(position, guess).0);
            }
        }
    }

    /// Reads the first hash table slot of each position. A guess other than [`EMPTY`] is correct.
    pub fn guess(&self, positions: impl Iterator<Item = DVec3> + Clone, guesses: &mut [u32]) {
        let Index::Hash(table) = &self.index else { return guesses.fill(EMPTY) };
        for (position, guess) in positions.clone().zip(&mut *guesses) {
            *guess = table.slots[table.first_slot(position)];
        }
        for (position, guess) in positions.zip(guesses) {
            if self.positions.get(*guess as usize).is_none_or(|known| E::key(*known) != E::key(position)) {
                *guess = EMPTY;
            }
        }
    }

    /// The number of a position, and whether it is new.
    pub fn number(&mut self, position: DVec3, guess: u32) -> (u32, bool) {
        let found = if guess == EMPTY { self.index.find_or_add(position, &self.positions) } else { (guess, false) };
        if found.1 {
            self.positions.push(position);
        }
        found
    }
}

/// Whether the positions of 0 to `count` are different numbers. O(n), in parallel if they are many.
pub fn are_distinct(count: usize, position: impl Fn(usize) -> DVec3 + Sync) -> bool {
    let all_new = |count: usize, positions: &mut dyn Iterator<Item = DVec3>| {
        let (mut distinct, mut next, mut is_distinct) = (Distinct::<Number>::with_capacity_for(count), 0u32, true);
        distinct.number_all(positions, |number| {
            is_distinct &= number == next;
            next = next.wrapping_add(1);
        });
        is_distinct
    };
    if count < FEW_POSITIONS {
        return all_new(count, &mut (0..count).map(position));
    }
    let chunks = by_shard::<Number>(count, &position);
    let is_distinct = threads::map(SHARDS, 2, |shard| {
        let members = || chunks.iter().flat_map(|lists| &lists[shard]);
        all_new(members().count(), &mut members().map(|&member| position(member as usize)))
    });
    !is_distinct.contains(&false)
}

/// The numbers of many positions by [`SHARDS`], each shard with the positions whose hashes end alike: a list for each chunk of
/// the positions. Equal positions are in one shard. Computed in parallel.
fn by_shard<E: Equality>(count: usize, position: &(impl Fn(usize) -> DVec3 + Sync)) -> Vec<[Vec<u32>; SHARDS]> {
    let shard_of = |position: DVec3| (hash_coordinates(E::key(position)) & (SHARDS as u64 - 1)) as usize;
    threads::map_chunks(count, |range| {
        let mut lists: [Vec<u32>; SHARDS] = Default::default();
        for number in range {
            #[expect(clippy::cast_possible_truncation, reason = "positions are counted in u32")]
            lists[shard_of(position(number))].push(number as u32);
        }
        lists
    })
}

/// For each position the first one that is equal to it: -0.0 equals 0.0. O(n), in parallel.
#[must_use]
pub fn first_equal(positions: &[DVec3]) -> Vec<u32> {
    first_equal_by::<Number>(positions)
}

/// Numbers the positions in order, equal ones alike, by the first equal one of each as [`first_equal`] finds it. Returns the
/// number of each position, and the first position of each number.
#[must_use]
pub fn number_by_first(mut first: Vec<u32>) -> (Vec<u32>, Vec<u32>) {
    let mut firsts = Vec::new();
    for at in 0..first.len() {
        let before = first[at] as usize;
        if before < at {
            first[at] = first[before];
        } else {
            firsts.push(first[at]);
            #[expect(clippy::cast_possible_truncation, reason = "no more than there are positions")]
            {
                first[at] = firsts.len() as u32 - 1;
            }
        }
    }
    (first, firsts)
}

/// For each position the first one that is equal to it. O(n), in parallel.
pub(super) fn first_equal_by<E: Equality>(positions: &[DVec3]) -> Vec<u32> {
    let chunks = by_shard::<E>(positions.len(), &|number| positions[number]);
    let shards = threads::map(SHARDS, 2, |shard| {
        let members = || chunks.iter().flat_map(|lists| lists[shard].iter().copied());
        let mut distinct = Distinct::<E>::with_capacity_for(members().count());
        let (mut first, mut equal) = (Vec::new(), Vec::new());
        let mut member = members();
        distinct.number_all(members().map(|member| positions[member as usize]), |number| {
            let member = member.next().unwrap_or_default();
            if number as usize == first.len() {
                first.push(member);
            }
            equal.push(first[number as usize]);
        });
        equal
    });
    let mut all = vec![0; positions.len()];
    for (shard, equal) in shards.into_iter().enumerate() {
        for (member, first) in chunks.iter().flat_map(|lists| &lists[shard]).zip(equal) {
            all[*member as usize] = first;
        }
    }
    all
}

/// Maps known positions to numbers. The hash function is fixed, so a crafted file can make all positions collide. If
/// lookups take more probes than chance explains, a tree replaces the table: O(log n) in every case.
enum Index<E> {
    Hash(Table<E>),
    Tree(BTreeMap<[u64; 3], u32>),
}

impl<E: Equality> Index<E> {
    /// The number of a position, and whether it is new; new positions get the next number. `known` has the position of
    /// each number.
    fn find_or_add(&mut self, position: DVec3, known: &[DVec3]) -> (u32, bool) {
        #[expect(clippy::cast_possible_truncation, reason = "no more than there were indices")]
        let next = known.len() as u32;
        if let Self::Hash(table) = self {
            if let Some(found) = table.find_or_add(position, known, next) {
                return (found, found == next);
            }
            *self = Self::Tree(known.iter().map(|&p| E::key(p)).zip(0..).collect());
        }
        let Self::Tree(tree) = self else { unreachable!("the table was replaced") };
        let found = *tree.entry(E::key(position)).or_insert(next);
        (found, found == next)
    }
}

/// A hash table of position numbers with open addressing and linear probing; the positions themselves are the keys.
struct Table<E> {
    slots: Vec<u32>,
    /// Right shift of a hash that leaves as many high bits as a slot index has.
    shift: u32,
    used: usize,
    /// Remaining probes, see [`PROBES_PER_LOOKUP`].
    probes_left: u64,
    equality: PhantomData<E>,
}

impl<E: Equality> Table<E> {
    fn with_capacity_for(positions: usize) -> Self {
        let bits = positions.next_power_of_two().trailing_zeros().max(4);
        Self {
            slots: vec![EMPTY; 1 << bits],
            shift: 64 - bits,
            used: 0,
            probes_left: BASE_PROBES,
            equality: PhantomData,
        }
    }

    /// None if the probes run out; the table is then unchanged.
    fn find_or_add(&mut self, position: DVec3, known: &[DVec3], next: u32) -> Option<u32> {
        if self.used * 4 >= self.slots.len() * 3 {
            self.grow(known)?;
        }
        self.probes_left += PROBES_PER_LOOKUP;
        let mut at = self.first_slot(position);
        loop {
            let found = self.slots[at];
            if found == EMPTY {
                self.slots[at] = next;
                self.used += 1;
                return Some(next);
            }
            if E::key(known[found as usize]) == E::key(position) {
                return Some(found);
            }
            at = self.next_slot(at)?;
        }
    }

    fn grow(&mut self, known: &[DVec3]) -> Option<()> {
        self.shift -= 1;
        let slots = self.slots.len() * 2;
        // Frees the old table before allocating the new one, so that they are never in memory together.
        self.slots = Vec::new();
        self.slots = vec![EMPTY; slots];
        self.probes_left += PROBES_PER_LOOKUP * known.len() as u64;
        for (&position, number) in known.iter().zip(0u32..) {
            let mut at = self.first_slot(position);
            while self.slots[at] != EMPTY {
                at = self.next_slot(at)?;
            }
            self.slots[at] = number;
        }
        Some(())
    }

    fn first_slot(&self, position: DVec3) -> usize {
        #[expect(clippy::cast_possible_truncation, reason = "as many bits as the table has")]
        {
            (hash_coordinates(E::key(position)) >> self.shift) as usize
        }
    }

    fn next_slot(&mut self, at: usize) -> Option<usize> {
        self.probes_left = self.probes_left.checked_sub(1)?;
        Some((at + 1) & (self.slots.len() - 1))
    }
}

/// Folded multiplication of each coordinate (as in wyhash, Wang Yi 2019); the constants are digits of pi.
#[must_use]
pub fn hash_coordinates([x, y, z]: [u64; 3]) -> u64 {
    let fold = |a: u64, b: u64| {
        let product = u128::from(a) * u128::from(b);
        #[expect(clippy::cast_possible_truncation, reason = "two halves of a product")]
        {
            (product as u64) ^ ((product >> 64) as u64)
        }
    };
    let h = fold(x ^ 0x243f_6a88_85a3_08d3, 0x1319_8a2e_0370_7345);
    let h = fold(h ^ y, 0xa409_3822_299f_31d1);
    fold(h ^ z, 0x082e_fa98_ec4e_6c89)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn numbered(distinct: &mut Distinct<impl Equality>, given: &[DVec3]) -> Vec<u32> {
        let mut numbers = Vec::new();
        distinct.number_all(given.iter().copied(), |number| numbers.push(number));
        numbers
    }

    /// Positions on a small grid, so that many are equal.
    fn crowded(count: u32) -> Vec<DVec3> {
        let number = |i: u32| f64::from(i.wrapping_mul(2_654_435_761) >> 22);
        (0..count).map(|i| DVec3::new(number(i) % 9.0, number(i + 7) % 9.0, number(i + 13) % 9.0)).collect()
    }

    /// The numbers of positions, and whether the tree replaced the table.
    fn numbers(given: &[DVec3], slots: usize) -> (Vec<u32>, bool) {
        let mut distinct = Distinct::<Number>::with_capacity_for(slots);
        let found = numbered(&mut distinct, given);
        (found, matches!(distinct.index, Index::Tree(_)))
    }

    #[test]
    fn the_first_equal_position_is_found_for_many_positions() {
        let given: Vec<DVec3> = crowded(2001).into_iter().cycle().take(100_000).collect();
        let slow = |position: &DVec3| given[..2001].iter().position(|p| p == position).unwrap();
        assert!(first_equal(&given).iter().zip(&given).all(|(&first, position)| first as usize == slow(position)));
    }

    #[test]
    fn one_repeated_position_among_few_and_among_many_is_noticed() {
        for count in [2, 1000, FEW_POSITIONS + 1000] {
            let line = |number: usize| DVec3::new(number as f64, -0.0, 1.0);
            assert!(are_distinct(count, line));
            let repeats = |number: usize| line(if number + 1 == count { 0 } else { number });
            assert!(!are_distinct(count, repeats), "{count}");
        }
    }

    #[test]
    fn minus_zero_is_zero_as_a_number_and_not_by_its_bits() {
        let given = [DVec3::ZERO, DVec3::new(-0.0, 0.0, 0.0), DVec3::ZERO];
        assert_eq!(numbered(&mut Distinct::<Number>::with_capacity_for(3), &given), [0, 0, 0]);
        assert_eq!(numbered(&mut Distinct::<Bits>::with_capacity_for(3), &given), [0, 1, 0]);
    }

    #[test]
    fn numbers_agree_with_comparing_each_position_with_all_before() {
        let given = crowded(2001);
        let mut known: Vec<DVec3> = Vec::new();
        let slow: Vec<u32> = given
            .iter()
            .map(|p| {
                let found = known.iter().position(|k| k == p).unwrap_or(known.len());
                if found == known.len() {
                    known.push(*p);
                }
                u32::try_from(found).unwrap()
            })
            .collect();
        assert_eq!(numbers(&given, given.len()), (slow.clone(), false));
        assert_eq!(numbers(&given, 1), (slow, false), "grown from the least table");
    }

    #[test]
    fn positions_crafted_to_collide_are_welded_by_the_tree_correctly() {
        // The hashes of these positions share their ten highest bits, which select the slot.
        let hostile = (0u32..)
            .map(|i| DVec3::new(f64::from(i), 0.5, 0.25))
            .filter(|&p| hash_coordinates(position_key(p)) >> 54 == 0);
        let mut given: Vec<DVec3> = hostile.take(3000).collect();
        given.extend_from_within(..);
        let (attacked, by_tree) = numbers(&given, given.len() / 4);
        assert!(by_tree, "the probes should have been spent");
        assert!(attacked.into_iter().eq((0..3000).chain(0..3000)));
    }
}
