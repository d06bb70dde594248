//! The header matches the functions. `UPDATE_HEADER=1 cargo test -p tcgs-capi` writes it.

#[test]
fn the_header_is_up_to_date() {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    let header = folder.join("include/tcgs.h");
    let mut made = Vec::new();
    cbindgen::generate(folder).expect("functions for a header").write(&mut made);
    if std::env::var_os("UPDATE_HEADER").is_some() {
        std::fs::write(&header, &made).expect("a header that can be written");
    }
    let found = std::fs::read(&header).expect("include/tcgs.h");
    assert!(found == made, "include/tcgs.h is not up to date: UPDATE_HEADER=1 cargo test -p tcgs-capi writes it");
}
