//! Searches settings of the codec that are better than those of a quality: fewer bytes at the same PSNR. The paces in
//! `CompressSettings::with_quality` were set by what it found.
//!
//! ```sh
//! cargo run --release -p tcgs-pipeline --example search_settings -- RUN CAPTURE QUALITY
//! ```
//!
//! One setting after another is moved up and down as long as that gains; then all again with smaller strides. Images are those
//! of training cameras: held-out ones are for measuring what was found.

use std::path::Path;

use tcgs_capture::{Capture, Split};
use tcgs_codec::CompressSettings;
use tcgs_pipeline::{
    Backend, CompressOptions, CompressPreset, Judge, JudgeImages, OpenScene, OpenSettings, PrunedScene, settings_of,
};

/// Name of a setting, how a stride moves it, and the stride.
type Move = (&'static str, fn(&mut CompressSettings, f32), f32);

// Places in the settings, by `Attribute::index`.
const MEAN: usize = 0;
const QUAT: usize = 1;
const SCALE: usize = 2;
const OPACITY: usize = 3;
const COLOR: usize = 4;

/// Tolerances move by factors, as lengths; bits and the exponent by sums.
const MOVES: [Move; 9] = [
    ("tolerance of positions", |s, by| s.max_mse[MEAN] *= 4.0_f32.powf(by), 0.4),
    ("tolerance of rotations", |s, by| s.max_mse[QUAT] *= 4.0_f32.powf(by), 0.4),
    ("tolerance of colours", |s, by| s.max_mse[COLOR] *= 4.0_f32.powf(by), 0.4),
    ("bits less of rotations", |s, by| s.coarser[QUAT] += by, 0.5),
    ("bits less of scales", |s, by| s.coarser[SCALE] += by, 0.5),
    ("bits less of opacities", |s, by| s.coarser[OPACITY] += by, 0.5),
    ("bits less of colours", |s, by| s.coarser[COLOR] += by, 0.5),
    ("fineness of positions", |s, by| s.position_fineness *= 2.0_f32.powf(by), 0.3),
    ("exponent of importance", |s, by| s.importance += by, 0.15),
];

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [run, capture, quality] = &arguments[..] else { return Err("usage: RUN CAPTURE QUALITY".into()) };
    let scene = OpenScene::open(Path::new(run), OpenSettings::default())?;
    let kind = Capture::open(Path::new(capture))?.kind();
    let (settings, mapping) = settings_of(CompressPreset::Default, kind, &scene)?;
    let images = JudgeImages { capture: Some(capture.into()), split: Split::Train, frames: None };
    let judge = Judge::new(&scene, &images, Backend::Cpu.renderer())?;
    let pruned = PrunedScene::new(&scene, &CompressOptions { mapping, ..CompressOptions::default() })?;
    // log2 of the bytes, and dB.
    let measure = |settings: &CompressSettings| -> Result<(f64, f64), Box<dyn std::error::Error>> {
        let (compact, file) = pruned.compress(settings)?;
        Ok(((file.len() as f64).log2(), judge.psnr(&compact)?))
    };
    let of_quality = |quality: f32| settings.clone().with_quality(quality);
    let quality: f32 = quality.parse()?;
    let [below, above] = [measure(&of_quality(quality - 0.5))?, measure(&of_quality(quality + 0.5))?];
    // What a doubling of the bytes buys along the curve that there is.
    let slope = (above.1 - below.1) / (above.0 - below.0);
    let start = measure(&of_quality(quality))?;
    println!("quality {quality}: {:.0} bytes, {:.3} dB; a doubling buys {slope:.3} dB", start.0.exp2(), start.1);
    let value = |(bytes, psnr): (f64, f64)| psnr - slope * bytes;
    let (mut best, mut found, mut moved) = (of_quality(quality), start, [0.0; MOVES.len()]);
    for scale in [1.0, 0.5] {
        loop {
            let before = value(found);
            for (i, (name, apply, stride)) in MOVES.iter().enumerate() {
                for by in [scale * stride, -scale * stride] {
                    let mut is_better = true;
                    while is_better {
                        let mut tried = best.clone();
                        apply(&mut tried, by);
                        let of_tried = measure(&tried)?;
                        is_better = value(of_tried) > value(found) + 1e-4;
                        if is_better {
                            (best, found) = (tried, of_tried);
                            moved[i] += by;
                            let gain = 100.0 * (1.0 - (-(value(found) - value(start)) / slope).exp2());
                            println!("{name} {:+.2}: {gain:.1} % fewer bytes at equal PSNR", moved[i]);
                        }
                    }
                }
            }
            if value(found) - before < 0.002 * slope {
                break;
            }
        }
    }
    println!("{:.0} bytes, {:.3} dB", found.0.exp2(), found.1);
    for ((name, ..), by) in MOVES.iter().zip(moved) {
        println!("{name:24} {by:+.2}");
    }
    println!("{best:#?}");
    Ok(())
}
