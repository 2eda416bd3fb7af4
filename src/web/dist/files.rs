// Written by build.mjs.
pub(super) const DOCUMENT: &str = include_str!("index.html");
pub(super) const MANUAL: &str = include_str!("manual.html");
pub(super) const WIDGET: &str = include_str!("widget.js");
#[rustfmt::skip]
pub(super) const ASSETS: [(&str, &[u8]); 5] = [
    ("icon-70B5C160.svg", include_bytes!("icon-70B5C160.svg")),
    ("manual-2QAXMAJ5.css", include_bytes!("manual-2QAXMAJ5.css")),
    ("page-5HJ6FHAE.js", include_bytes!("page-5HJ6FHAE.js")),
    ("style-3TUSHM67.css", include_bytes!("style-3TUSHM67.css")),
    ("viewer-IBGLV3EJ.js", include_bytes!("viewer-IBGLV3EJ.js")),
];
