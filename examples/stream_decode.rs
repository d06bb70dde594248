//! Decodes a file from bytes as a network would bring them, and says what can be shown when.
//!
//! `cargo run --release --example stream_decode tcgs-demo/scene.tcgs`

use std::fs::File;
use std::io::Read;

use anyhow::Context;
use tcgs::codec::{DecodeLimits, Decoder, Event, Sampler};

fn main() -> anyhow::Result<()> {
    let path = std::env::args().nth(1).context("expected a .tcgs file")?;
    let mut file = File::open(&path).with_context(|| path.clone())?;
    let mut decoder = Decoder::new(DecodeLimits::default());
    let mut packet = [0; 4096];
    let mut received = 0;
    while !decoder.is_finished() {
        let length = file.read(&mut packet)?;
        anyhow::ensure!(length > 0, "{path}: ends after {received} bytes, expected more");
        received += length;
        for event in decoder.push(&packet[..length])? {
            match event {
                Event::Header => {
                    let archive = decoder.archive().context("a header was read")?;
                    let info = archive.info();
                    let (gaussians, timesteps) = (info.num_gaussians, info.num_timesteps);
                    println!("{received:>9} bytes: {gaussians} Gaussians, {timesteps} timesteps to come");
                }
                Event::Layer { layers, .. } => {
                    println!("{received:>9} bytes: layer {layers} of what all segments share")
                }
                Event::Segment(segment) => {
                    let (timesteps, shown) = (segment.timesteps(), segment.num_gaussians());
                    // Any timestep of a segment can be had, in any order; one after another is cheapest.
                    let mut sampler = Sampler::new(&segment);
                    let mean = sampler.at(timesteps.start).means().first();
                    println!(
                        "{received:>9} bytes: timesteps {timesteps:?} with {shown} Gaussians, the first at {mean:?}"
                    );
                }
                Event::End => println!("{received:>9} bytes: complete"),
            }
        }
    }
    Ok(())
}
