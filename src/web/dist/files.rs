// Written by build.mjs.
pub(super) const DOCUMENT: &str = include_str!("index.html");
pub(super) const MANUAL: &str = include_str!("manual.html");
pub(super) const WIDGET: &str = include_str!("widget.js");
#[rustfmt::skip]
pub(super) const ASSETS: [(&str, &[u8]); 5] = [
    ("icon-70B5C160.svg", include_bytes!("icon-70B5C160.svg")),
    ("manual-U4WGFUJN.css", include_bytes!("manual-U4WGFUJN.css")),
    ("page-LBZ3S4XY.js", include_bytes!("page-LBZ3S4XY.js")),
    ("style-SITLIM6H.css", include_bytes!("style-SITLIM6H.css")),
    ("viewer-LRWP7PXD.js", include_bytes!("viewer-LRWP7PXD.js")),
];
