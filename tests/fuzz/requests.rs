//! HTTP requests determined by a seed, most of them valid except for one thing.

use crate::damage::Random;
use crate::mutate::{damage_some, file};

/// Options, some of which are unknown, out of range or of the wrong type.
const OPTIONS: [&str; 14] = [
    "{}",
    r#"{"mode":"analyze","level":"basic","up":[0,0,1],"unit":"mm"}"#,
    r#"{"mode":"repair","max_tier":1,"with":["fill_holes"],"without":"fill_holes,"}"#,
    r#"{"max_tier":2.0,"max_faces":1e3,"deadline_s":1}"#,
    r#"{"max_faces":18446744073709551615,"max_error":1e308,"voxel_size":5e-324}"#,
    r#"{"mode":"analyze","tolerances":{"linear":{"of_diagonal":1e-7},"sheet":{"length":-1}},"build_volume":[1,1,1e-320]}"#,
    r#"{"mode":"analyze","max_tier":1}"#,
    r#"{"deadline_s":null}"#,
    r#"{"mode":7}"#,
    r#"{"preset":"auto","preset":"fill-holes"}"#,
    "[]",
    "null",
    "{\"mode\":",
    "",
];
const METADATA: [&str; 5] = [r#"{"order":"17","\u0000":"\ud83d\ude00"}"#, "{}", r#"{"order":17}"#, "[[[[[[", ""];
const CALLBACKS: [&str; 5] =
    ["https://shop.example/done", "http://127.0.0.1:1/", "https://[::1]:443/", "https://a:b@c/", "x"];
const NAMES: [&str; 6] = ["a.stl", "", "../../etc/passwd", "C:\\x.obj", "%00\u{202e}lts.a", "\u{f6}.ply"];

/// A multipart form with the boundary `X`.
pub fn form(seed: u64) -> Vec<u8> {
    let random = &mut Random::new(seed);
    let mut form = Vec::new();
    for _ in 0..random.below(5) {
        let name = NAMES[random.below(NAMES.len())];
        let (head, body) = match random.below(8) {
            0..4 => (format!("\"file\"; filename=\"{name}\""), file(seed.wrapping_add(form.len() as u64))),
            4 | 5 => ("\"options\"".to_owned(), OPTIONS[random.below(OPTIONS.len())].into()),
            6 => ("\"metadata\"".to_owned(), METADATA[random.below(METADATA.len())].into()),
            _ => ("callback_url".to_owned(), CALLBACKS[random.below(CALLBACKS.len())].into()),
        };
        form.extend_from_slice(format!("--X\r\ncontent-disposition: form-data; name={head}\r\n\r\n").as_bytes());
        form.extend_from_slice(&body);
        form.extend_from_slice(b"\r\n");
    }
    form.extend_from_slice(b"--X--\r\n");
    if random.below(2) == 0 {
        damage_some(&mut form, random);
    }
    form
}

/// A complete request, most often one that creates a job.
pub fn request(seed: u64) -> Vec<u8> {
    let random = &mut Random::new(seed);
    let of_text = |random: &mut Random, texts: &[&str]| texts[random.below(texts.len())].to_owned();
    let options = of_text(random, &OPTIONS);
    let (metadata, callback) = (of_text(random, &METADATA), of_text(random, &CALLBACKS));
    let json = "content-type: application/json";
    let id = ["upl_019a3c5e7b1f7c3e8d2a4b6c8d0e2f4a", "upl_", ""][random.below(3)];
    let job = ["job_019a3c5e7b1f7c3e8d2a4b6c8d0e2f4a", "%ff", ".."][random.below(3)];
    let (head, body) = match random.below(10) {
        0..3 => (
            "POST /v1/jobs?name=a.stl&max_tier=1&with=fill_holes&mode=repair\ncontent-type: model/stl\nidempotency-key: \"7\"".to_owned(),
            file(seed),
        ),
        3 => ("POST /v1/jobs?mode=analyze&up=[0,1,0]&unit=mm&metadata={}\ncache-control: no-cache".to_owned(), file(seed)),
        4..7 => {
            let text = format!(
                r#"{{"source":{{"upload_id":"{id}"}},"options":{options},"metadata":{metadata},"callback_url":"{callback}"}}"#
            );
            (format!("POST /v1/jobs\n{json}"), text.into_bytes())
        }
        7 => {
            let texts = [r#"{"name":"a.stl","bytes":30.0}"#, r#"{"bytes":1e99}"#, "null", r#"{"name":7}"#, ""];
            (format!("POST /v1/uploads\n{json}"), of_text(random, &texts).into_bytes())
        }
        8 => {
            let texts = [
                ("browser-tokens", r#"{"origin":"https://shop.example","scopes":["jobs:read"],"max_bytes":9,"expires_in_s":60}"#),
                ("browser-tokens", r#"{"origin":"x","scopes":["tokens"]}"#),
                ("webhook-endpoints", r#"{"url":"https://shop.example/","events":["job.failed"],"description":"x"}"#),
                ("webhook-endpoints/we_019a3c5e7b1f7c3e8d2a4b6c8d0e2f4a/rotate", ""),
            ];
            let (path, text) = texts[random.below(texts.len())];
            (format!("POST /v1/{path}\n{json}"), text.into())
        }
        _ => {
            let lines = [
                format!("GET /v1/jobs/{job}?wait=60\nprefer: wait=9\nif-none-match: W/\"1\", *"),
                format!("GET /v1/jobs/{job}/artifacts/model\nrange: bytes=0-1,-5\nif-range: \"x\""),
                "GET /v1/jobs?limit=200&status=queued&cursor=job_019a3c5e7b1f7c3e8d2a4b6c8d0e2f4a".to_owned(),
                format!("PUT /v1/uploads/{id}/content?token=x"),
                "OPTIONS /v1/jobs\norigin: https://shop.example\naccess-control-request-method: POST".to_owned(),
                "GET /docs/".to_owned(),
                "HEAD /v1/nothing".to_owned(),
            ];
            (lines[random.below(lines.len())].clone(), Vec::new())
        }
    };
    let mut request = head.into_bytes();
    request.extend_from_slice(b"\n\n");
    request.extend_from_slice(&body);
    if random.below(2) == 0 {
        damage_some(&mut request, random);
    }
    request
}
