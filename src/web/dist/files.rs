// Written by build.mjs.
pub(super) const DOCUMENT: &[u8] = include_bytes!("index.html");
#[rustfmt::skip]
pub(super) const ASSETS: [(&str, &[u8]); 5] = [
    ("chunk-ZON466D3.js", include_bytes!("chunk-ZON466D3.js")),
    ("icon-70B5C160.svg", include_bytes!("icon-70B5C160.svg")),
    ("mod-X64ZTTJU.js", include_bytes!("mod-X64ZTTJU.js")),
    ("page-UCISYSRN.js", include_bytes!("page-UCISYSRN.js")),
    ("style-OU5USZK4.css", include_bytes!("style-OU5USZK4.css")),
];
