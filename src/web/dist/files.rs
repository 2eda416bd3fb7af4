// Written by build.mjs.
pub(super) const DOCUMENT: &[u8] = include_bytes!("index.html");
#[rustfmt::skip]
pub(super) const ASSETS: [(&str, &[u8]); 5] = [
    ("chunk-ZON466D3.js", include_bytes!("chunk-ZON466D3.js")),
    ("icon-70B5C160.svg", include_bytes!("icon-70B5C160.svg")),
    ("mod-DGACQACA.js", include_bytes!("mod-DGACQACA.js")),
    ("page-YDL5TE6P.js", include_bytes!("page-YDL5TE6P.js")),
    ("style-XPEMEIKH.css", include_bytes!("style-XPEMEIKH.css")),
];
