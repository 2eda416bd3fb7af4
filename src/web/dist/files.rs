// Written by build.mjs.
pub(super) const DOCUMENT: &str = include_str!("index.html");
pub(super) const MANUAL: &str = include_str!("manual.html");
pub(super) const WIDGET: &str = include_str!("widget.js");
#[rustfmt::skip]
pub(super) const ASSETS: [(&str, &[u8]); 5] = [
    ("icon-70B5C160.svg", include_bytes!("icon-70B5C160.svg")),
    ("manual-2QAXMAJ5.css", include_bytes!("manual-2QAXMAJ5.css")),
    ("page-JH4YMT7I.js", include_bytes!("page-JH4YMT7I.js")),
    ("style-KDZOWNAJ.css", include_bytes!("style-KDZOWNAJ.css")),
    ("viewer-RCFFDEIZ.js", include_bytes!("viewer-RCFFDEIZ.js")),
];
