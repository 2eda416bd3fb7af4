// Written by build.mjs.
pub(super) const DOCUMENT: &[u8] = include_bytes!("index.html");
#[rustfmt::skip]
pub(super) const ASSETS: [(&str, &[u8]); 5] = [
    ("chunk-ZON466D3.js", include_bytes!("chunk-ZON466D3.js")),
    ("icon-70B5C160.svg", include_bytes!("icon-70B5C160.svg")),
    ("mod-X64ZTTJU.js", include_bytes!("mod-X64ZTTJU.js")),
    ("page-YYSXCKKD.js", include_bytes!("page-YYSXCKKD.js")),
    ("style-CCBU4UV5.css", include_bytes!("style-CCBU4UV5.css")),
];
