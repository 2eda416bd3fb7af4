// Written by build.mjs.
pub(super) const DOCUMENT: &[u8] = include_bytes!("index.html");
#[rustfmt::skip]
pub(super) const ASSETS: [(&str, &[u8]); 5] = [
    ("chunk-ZON466D3.js", include_bytes!("chunk-ZON466D3.js")),
    ("icon-70B5C160.svg", include_bytes!("icon-70B5C160.svg")),
    ("mod-DGACQACA.js", include_bytes!("mod-DGACQACA.js")),
    ("page-XPNATSO5.js", include_bytes!("page-XPNATSO5.js")),
    ("style-XPEMEIKH.css", include_bytes!("style-XPEMEIKH.css")),
];
