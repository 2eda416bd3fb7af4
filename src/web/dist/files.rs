// Written by build.mjs.
pub(super) const DOCUMENT: &[u8] = include_bytes!("index.html");
pub(super) const MANUAL: &str = include_str!("manual.html");
#[rustfmt::skip]
pub(super) const ASSETS: [(&str, &[u8]); 6] = [
    ("chunk-ZON466D3.js", include_bytes!("chunk-ZON466D3.js")),
    ("icon-70B5C160.svg", include_bytes!("icon-70B5C160.svg")),
    ("manual-5VXI4EXN.css", include_bytes!("manual-5VXI4EXN.css")),
    ("mod-DGACQACA.js", include_bytes!("mod-DGACQACA.js")),
    ("page-FDPUX4CU.js", include_bytes!("page-FDPUX4CU.js")),
    ("style-XPEMEIKH.css", include_bytes!("style-XPEMEIKH.css")),
];
