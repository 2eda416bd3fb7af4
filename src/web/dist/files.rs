// Written by build.mjs.
pub(super) const DOCUMENT: &[u8] = include_bytes!("index.html");
#[rustfmt::skip]
pub(super) const ASSETS: [(&str, &[u8]); 5] = [
    ("chunk-ZON466D3.js", include_bytes!("chunk-ZON466D3.js")),
    ("icon-70B5C160.svg", include_bytes!("icon-70B5C160.svg")),
    ("mod-H7J6BHB5.js", include_bytes!("mod-H7J6BHB5.js")),
    ("page-OU56T7ZX.js", include_bytes!("page-OU56T7ZX.js")),
    ("style-6ZIHK35B.css", include_bytes!("style-6ZIHK35B.css")),
];
