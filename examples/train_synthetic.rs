//! Trains three timesteps of a ray-traced capture and compresses them: `tcgs demo` from the inside.
//!
//! `cargo run --release --example train_synthetic` takes a quarter of a minute on two cores and writes
//! `train_synthetic.tcgs`.

use std::ops::ControlFlow;

use tcgs::capture::{Capture, Split, SyntheticSettings, write_synthetic};
use tcgs::codec::{CompactFile, CompressSettings, FORMAT_VERSION, SceneInfo, compress};
use tcgs::core::DynamicGaussians;
use tcgs::train::{TrainConfig, Trainer};

fn main() -> anyhow::Result<()> {
    let folder = tempfile::tempdir()?;
    write_synthetic(folder.path(), &SyntheticSettings { num_timesteps: 3, ..SyntheticSettings::default() })?;
    let capture = Capture::open(folder.path())?;

    let mut config = TrainConfig::default();
    config.data.end_frame = 3;
    (config.schedule.first_iterations, config.schedule.rest_iterations) = (600, 100);
    // All timesteps have the same Gaussians.
    (config.births.enabled, config.deaths.patience) = (false, 0);
    let cameras: Vec<_> = capture.cameras(Split::Train, 0, 1)?.into_iter().map(|(_, camera)| camera).collect();
    let mut trainer = Trainer::new(&config, &capture.point_cloud()?, &cameras)?;

    let mut scene = DynamicGaussians::new(trainer.state()?.parameters.gaussians.layout().clone());
    for frame in 0..3 {
        let mut loss = 0.0;
        trainer.fit(&capture.views(Split::Train, frame, 1)?, &mut |progress| {
            loss = progress.loss;
            ControlFlow::Continue(())
        })?;
        let psnr = trainer.mean_psnr(&capture.views(Split::Test, frame, 1)?)?;
        println!("frame {frame}: loss {loss:.3}, {psnr:.2} dB on the held-out cameras");
        scene.push(trainer.state()?.parameters.gaussians.clone());
    }

    // A run's folder has the bits that training gave each Gaussian; here all have the same.
    let bits = tcgs::codec::BitMap::uniform(scene.num_gaussians(), 14, 8);
    let compact = compress(&scene, &bits, None, SceneInfo::of(&scene), &CompressSettings::default())?;
    let file = CompactFile::of(compact).encode(FORMAT_VERSION, &[])?;
    println!("{} bytes of floats, {} in train_synthetic.tcgs", scene.raw_bytes(), file.len());
    std::fs::write("train_synthetic.tcgs", file)?;
    Ok(())
}
