//! Prints of each `.tcgs` file a checksum of all its floats, to compare machines: decoders agree bit for bit.
//!
//! ```sh
//! cargo run --release --manifest-path .ci/checksum/Cargo.toml -- testdata/bitstream/v2/*.tcgs
//! ```

use std::io::Cursor;

use tcgs_codec::{DecodeLimits, SceneFile, SegmentCache};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    for path in std::env::args().skip(1) {
        let file = Cursor::new(std::fs::read(&path)?);
        let mut scene = SceneFile::open(file, &DecodeLimits::default(), SegmentCache::DEFAULT_BYTES)?;
        let mut hasher = crc32fast::Hasher::new();
        for timestep in 0..scene.info().num_timesteps as usize {
            let gaussians = scene.at(timestep)?;
            for attribute in gaussians.layout().attributes() {
                gaussians.values(attribute).iter().for_each(|value| hasher.update(&value.to_le_bytes()));
            }
        }
        println!("{:08x} {path}", hasher.finalize());
    }
    Ok(())
}
