//! tcgs
fn main() {}
