//! Dynamic 3D Gaussian splatting: multi-view video in, a moving 3D scene out that is small enough to stream.
//!
//! A scene is a set of 3D Gaussians that move over time. `tcgs` trains it from images of synchronized cameras,
//! compresses it to a `.tcgs` file, and reads any timestep of that file. The method is Dynamic 3D Gaussians with
//! learned masks and learned quantisation, as in the paper *Temporally Compressed 3D Gaussian Splatting for Dynamic
//! Scenes*. No CUDA is needed: everything runs on CPUs, and on GPUs by `wgpu`. The command line is the crate
//! `tcgs-cli`.
//!
//! | module | what | feature |
//! |---|---|---|
//! | [`core`] | Gaussians, cameras, images, activations with their gradients | |
//! | [`codec`] | `.tcgs` files: decodes them; with `pipeline` compresses and writes them | |
//! | [`pipeline`] | the whole way, as the command line goes it: open any scene, train, compress, evaluate, render, export | `pipeline` |
//! | [`capture`] | multi-view captures: reads their cameras, images and videos | `pipeline` |
//! | [`prepare`] | makes captures of videos: cameras, clocks, masks, initial points; checks them | `pipeline` |
//! | [`render`] | a differentiable rasterizer, on CPUs and GPUs | `pipeline` |
//! | [`train`] | the optimisation, one timestep after another | `pipeline` |
//! | [`metrics`] | PSNR, SSIM, MS-SSIM, LPIPS, flicker, and the protocols of publications | `pipeline` |
//! | [`interchange`] | PLY, SPZ, glTF, `.4dgs` and `params.npz` of other programs | `pipeline` |
//! | `play` | a player that fetches, decodes and draws, for windows and browsers | `play` |
//!
//! By default `pipeline` is on, with GPUs (`gpu`), LPIPS (`lpips`) and H.264 (`video`, which takes a C++ compiler).
//! `default-features = false` leaves a decoder in pure Rust.
//!
//! ```toml
//! tcgs = { path = "tcgs/crates/tcgs" } # or git = "…"
//! ```
//!
//! # Read a file
//!
//! ```
//! use tcgs::codec::{DecodeLimits, SceneFile, SegmentCache};
//! use tcgs::core::activate;
//!
//! # let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../testdata/bitstream/v1/room_default.tcgs");
//! let file = std::io::BufReader::new(std::fs::File::open(path)?);
//! let mut scene = SceneFile::open(file, &DecodeLimits::default(), SegmentCache::DEFAULT_BYTES)?;
//! let gaussians = activate(&scene.lit(7)?); // standard deviations, opacities between 0 and 1
//! assert_eq!(gaussians.means.len(), gaussians.scales.len());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # Train and compress
//!
#![cfg_attr(feature = "pipeline", doc = "```")]
#![cfg_attr(not(feature = "pipeline"), doc = "```ignore")]
//! use tcgs::capture::{Capture, SyntheticSettings, write_synthetic};
//! use tcgs::pipeline::{
//!     Backend, CompressOptions, OpenScene, OpenSettings, Unobserved, compress_scene, fit, new_trainer, settings_for,
//! };
//! use tcgs::train::{Preset, Run};
//!
//! # let folder = tempfile::tempdir()?;
//! # let (my_capture, run_folder) = (folder.path().join("capture"), folder.path().join("run"));
//! # let small = SyntheticSettings { width: 48, height: 36, num_timesteps: 2, num_points: 300, ..Default::default() };
//! # write_synthetic(&my_capture, &small)?;
//! let capture = Capture::open(&my_capture)?; // a folder of images or videos with cameras
//! let mut config = settings_for(Preset::Fast, &capture);
//! # (config.schedule.first_iterations, config.schedule.rest_iterations) = (20, 5);
//! config.set("schedule.rest_iterations", "5")?; // every setting of config.toml
//! let run = Run::create(&run_folder, &config)?;
//! let trainer = new_trainer(&config, &capture, &Backend::Cpu)?;
//! fit(&capture, &run, trainer, &mut Unobserved)?;
//!
//! let trained = OpenScene::open(run.folder(), OpenSettings::default())?;
//! let options = CompressOptions { capture: Some(my_capture), ..CompressOptions::default() };
//! std::fs::write(run_folder.join("scene.tcgs"), compress_scene(&trained, &options)?.file)?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! The programs in `examples/` go further: gradients of a pixel, a training loop of one's own, decoding while bytes
//! arrive. `cargo run --release --example first_splat` runs the first.

// Modules that a build lacks have no links.
#![cfg_attr(not(feature = "pipeline"), allow(rustdoc::broken_intra_doc_links))]

pub use tcgs_codec as codec;
pub use tcgs_core as core;

#[cfg(feature = "pipeline")]
pub use {
    tcgs_capture as capture, tcgs_interchange as interchange, tcgs_metrics as metrics, tcgs_pipeline as pipeline,
    tcgs_prepare as prepare, tcgs_render as render, tcgs_train as train,
};

#[cfg(feature = "play")]
pub use tcgs_play as play;
