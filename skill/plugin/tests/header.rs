//! The header is what the sources say.

use std::path::Path;

#[test]
fn the_header_is_made_from_the_sources() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let config = cbindgen::Config::from_file(root.join("cbindgen.toml")).unwrap();
    let mut builder = cbindgen::Builder::new().with_config(config);
    for source in ["boundary", "frame", "session", "answers"] {
        builder = builder.with_src(root.join(format!("src/{source}.rs")));
    }
    let mut made = Vec::new();
    builder.generate().unwrap().write(&mut made);
    let header = root.join("include/linkage.h");
    if std::env::var_os("LINKAGE_BLESS").is_some() {
        std::fs::write(&header, &made).unwrap();
    }
    let made = String::from_utf8(made).unwrap();
    let kept = std::fs::read_to_string(&header).unwrap_or_default();
    assert!(made == kept, "write it again with LINKAGE_BLESS=1 cargo test -p linkage-plugin");
}
