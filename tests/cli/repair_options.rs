//! What `meshmend repair` says of options.

use super::{Desk, code, files, said};

#[test]
fn an_option_that_was_not_applied_is_in_the_last_lines() {
    let desk = Desk::new();
    desk.put("box.stl", &files::stl(&files::BOX));
    let output = desk.run(&["repair", "box.stl", "-o", "out.stl", "--nested", "alternate", "--stitch-distance", "0.5"]);
    assert_eq!(code(&output), 0, "{}", said(&output));
    let lines = said(&output);
    let last: Vec<&str> = lines.trim_end().lines().rev().take(2).collect();
    assert_eq!(last[0], "  note: `nested=alternate` had nothing to do: no part had to be turned");
    assert_eq!(last[1], "  note: `stitch_distance=0.5` had nothing to do: no crack is within it");
    assert_eq!(desk.get("out.stl"), desk.get("box.stl"));
}

#[test]
fn a_length_below_zero_is_refused_with_the_name_of_its_option() {
    let desk = Desk::new();
    desk.put("box.stl", &files::stl(&files::BOX));
    let output = desk.run(&["repair", "box.stl", "-o", "out.stl", "--merge-distance=-1"]);
    assert_eq!(code(&output), 2, "{}", said(&output));
    assert!(said(&output).contains("`merge_distance` must be"), "{}", said(&output));
}
