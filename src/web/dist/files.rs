// Written by build.mjs.
pub(super) const DOCUMENT: &str = include_str!("index.html");
pub(super) const MANUAL: &str = include_str!("manual.html");
pub(super) const WIDGET: &str = include_str!("widget.js");
#[rustfmt::skip]
pub(super) const ASSETS: [(&str, &[u8]); 5] = [
    ("icon-70B5C160.svg", include_bytes!("icon-70B5C160.svg")),
    ("manual-U4WGFUJN.css", include_bytes!("manual-U4WGFUJN.css")),
    ("page-PWVTTH22.js", include_bytes!("page-PWVTTH22.js")),
    ("style-744EOYWN.css", include_bytes!("style-744EOYWN.css")),
    ("viewer-LRWP7PXD.js", include_bytes!("viewer-LRWP7PXD.js")),
];
