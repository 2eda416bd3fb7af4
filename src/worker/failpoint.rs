/// A named place at which a test can make this process pause, by the variable `FAILPOINTS` of the crate `fail`; nothing
/// at all unless the feature `failpoints` is on.
pub fn pause_at(_name: &str) {
    fail::fail_point!(_name);
}
