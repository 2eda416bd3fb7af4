// Written by build.mjs.
pub(super) const DOCUMENT: &[u8] = include_bytes!("index.html");
pub(super) const MANUAL: &[u8] = include_bytes!("manual.html");
pub(super) const WIDGET: &[u8] = include_bytes!("widget.js");
#[rustfmt::skip]
pub(super) const ASSETS: [(&str, &[u8]); 5] = [
    ("icon-70B5C160.svg", include_bytes!("icon-70B5C160.svg")),
    ("manual-U4WGFUJN.css", include_bytes!("manual-U4WGFUJN.css")),
    ("page-63WNSBBW.js", include_bytes!("page-63WNSBBW.js")),
    ("style-744EOYWN.css", include_bytes!("style-744EOYWN.css")),
    ("viewer-LRWP7PXD.js", include_bytes!("viewer-LRWP7PXD.js")),
];
