//! A measurement after a change finds what a measurement of the whole surface finds.

use super::*;

const BELOW: f64 = 1.0;

/// A plate of blocks, 0.4 thick, with further blocks on it.
fn plate(on: &[[usize; 2]]) -> Surface {
    let side: Vec<f64> = (0..=12).map(f64::from).collect();
    blocks(&side, &side, &[0.0, 0.4, 1.1], |i, j, k| k == 0 || on.contains(&[i, j]))
}

/// The number of faces that were not measured again.
fn compare(before: &Surface, after: &Surface) -> usize {
    let pairs = search(before, BELOW, Space::Material);
    let earlier = Earlier { surface: before, pairs: &pairs };
    let found = with_context(|context| opposed_pairs_after(earlier, after, BELOW, Space::Material, context)).unwrap();
    let whole = search(after, BELOW, Space::Material);
    let places = |pairs: &[OpposedPair]| pairs.iter().map(|p| (p.faces[0], p.thickness)).collect::<Vec<_>>();
    assert_eq!(places(&found.walls), places(&whole.walls));
    assert_eq!(places(&found.tips), places(&whole.tips));
    assert!(!found.walls.is_empty() && found.is_complete);
    let after_change = |context: &Context<'_>| thin_features_after(earlier, after, BELOW, Space::Material, context);
    let regions = with_context(after_change).unwrap().regions;
    assert_eq!(regions, with_context(|context| thin_features(after, BELOW, Space::Material, context)).unwrap().regions);
    earlier.known(after, BELOW, 1.0).iter().flatten().count()
}

#[test]
fn only_faces_near_a_change_are_measured_again() {
    let (empty, one) = (plate(&[]), plate(&[[3, 4]]));
    let two = plate(&[[3, 4], [8, 8]]);
    for (before, after) in [(&empty, &one), (&one, &empty), (&one, &two), (&two, &empty)] {
        let kept = compare(before, after);
        assert!((300..after.faces.len() - 20).contains(&kept), "{kept} of {}", after.faces.len());
    }
    assert_eq!(compare(&one, &one), one.faces.len());
}

#[test]
fn a_wall_whose_other_side_is_gone_is_measured_again() {
    // A cut from below leaves faces above that are the same, but whose partners are gone.
    let side: Vec<f64> = (0..=12).map(f64::from).collect();
    let z = [0.0, 0.2, 0.4];
    let whole = blocks(&side, &side, &z, |_, _, _| true);
    let cut = blocks(&side, &side, &z, |i, j, k| k == 1 || [i, j] != [5, 5]);
    let thin = search(&cut, BELOW, Space::Material).walls.iter().filter(|pair| pair.thickness < 0.3).count();
    assert!(thin >= 4, "{thin}");
    compare(&whole, &cut);
    compare(&cut, &whole);
}
