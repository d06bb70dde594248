//! Files of clocks with wrong bytes: each is read, or refused in one line that names the file.

use rand::{RngExt, SeedableRng};
use tcgs_prepare::Clocks;

#[test]
fn files_of_any_bytes_are_read_or_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("offsets.txt");
    let whole = b"# when the ball is thrown\na 1.5\nb -0.25 # early\n";
    let mut random = rand_pcg::Pcg32::seed_from_u64(9);
    for round in 0..400 {
        let mut bytes = whole.to_vec();
        for _ in 0..round.min(3) {
            let at = random.random_range(0..bytes.len());
            match random.random_range(0..3) {
                0 => bytes[at] = random.random(),
                1 => bytes[at] ^= 1 << random.random_range(0..8),
                _ => bytes.truncate(at + 1),
            }
        }
        std::fs::write(&path, &bytes).unwrap();
        let clocks = Clocks::read(&path, &["a".into(), "b".into()]);
        assert!(round > 0 || clocks.is_ok());
        if let Err(error) = clocks {
            let message = error.to_string();
            assert!(message.starts_with(path.to_str().unwrap()) && !message.contains('\n'), "{message}");
        }
    }
}
