use std::process::Command;

use meshmend::format::{Limits, read};
use serde_json::Value;

use crate::server::Start;

#[tokio::test]
async fn the_example_in_the_readme_works_as_pasted() {
    let readme = include_str!("../../README.md");
    let block = |holding: &str| {
        let blocks = readme.split("```sh\n").skip(1).filter_map(|rest| rest.split("```").next());
        blocks.into_iter().find(|block| block.contains(holding)).expect("the example").to_owned()
    };
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(&data.path().join("data")).start();
    let script = block("# upload").replace("http://127.0.0.1:8080", &program.url);
    let folder = data.path().to_owned();
    let run = move |script: String| {
        let output = Command::new("bash").args(["-euo", "pipefail", "-c", &script]).current_dir(&folder).output();
        let output = output.expect("bash runs");
        let text = String::from_utf8_lossy(&output.stdout).into_owned();
        assert!(output.status.success(), "{text}{}", String::from_utf8_lossy(&output.stderr));
        text
    };
    let analyse = block("# analyse").replace("http://127.0.0.1:8080", &program.url);
    let (run, printed, analysed) = tokio::task::spawn_blocking(move || {
        let (printed, analysed) = (run(script), run(analyse));
        (run, printed, analysed)
    })
    .await
    .expect("no panic");
    assert!(printed.contains("\"outcome\": \"repaired\""), "{printed}");
    let report: Value = serde_json::from_str(&analysed).expect("a report");
    let printable: Vec<_> = report["files"].as_array().expect("files").iter().map(|file| &file["printable"]).collect();
    assert_eq!(printable, [false, true], "{report}");
    let model = std::fs::read(data.path().join("repaired.stl")).expect("the model");
    assert_eq!(read(&model, &Limits::default()).expect("a model").soup.faces.len(), 12);

    let local = block("meshmend repair")
        .replace("cargo build --release", "")
        .replace("./target/release/meshmend", env!("CARGO_BIN_EXE_meshmend"));
    let printed = tokio::task::spawn_blocking(move || run(local)).await.expect("no panic");
    assert!(printed.contains("printable") && !printed.contains("not printable"), "{printed}");
}
