/// A named place at which a test can make this process pause, by the variable `FAILPOINTS` of the crate `fail`; nothing
/// at all unless the feature `failpoints` is on. Beside that crate's own actions, `return(PATH)` waits until there is such a file.
pub fn pause_at(_name: &str) {
    fail::fail_point!(_name, |gate: Option<String>| {
        while !std::fs::exists(gate.as_deref().unwrap_or_default()).is_ok_and(|is_open| is_open) {
            std::thread::sleep(std::time::Duration::from_millis(10));
        }
    });
}

/// The same in the midst of a task of which other parts, such as heartbeats, go on.
pub(super) async fn pause_alone_at(name: &'static str) {
    if cfg!(feature = "failpoints") {
        let _ = tokio::task::spawn_blocking(move || pause_at(name)).await;
    }
}
