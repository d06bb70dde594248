//! Scenes of the bench: Gaussians as in the middle of a training, cameras and images.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use tcgs_capture::{Capture, Split};
use tcgs_codec::{BitMap, BitSettings};
use tcgs_core::{Attribute, BaseColumns, Camera, Image};
use tcgs_train::engine::Target;
use tcgs_train::{FakeQuantizers, Parameters, Past, Pose, State, TrainConfig};

use super::START_LOGIT;
use crate::options::Size;

/// One case of the bench.
pub struct BenchScene {
    /// Name for tables and JSON.
    pub name: String,
    /// State of a later timestep, so that no loss is zero by construction.
    pub state: State,
    /// Images with their cameras; at least one.
    pub targets: Vec<Target>,
}

impl BenchScene {
    /// The cameras of the images.
    pub fn cameras(&self) -> Vec<Camera> {
        self.targets.iter().map(|target| target.camera.clone()).collect()
    }

    /// Size of the first image, pixels.
    pub fn size(&self) -> Size {
        let camera = &self.targets[0].camera;
        Size { width: camera.width, height: camera.height }
    }
}

/// Focal length of the built-in scene's camera, in widths of its image: 64 degrees horizontally.
const FOCAL: f64 = 0.8;
/// Largest `|x/z|` and `|y/z|` of the built-in scene: the view of a 4:3 image. Wider images see less of the scene.
const SLOPE: [f32; 2] = [0.625, 0.469];
/// Nearest and farthest depth, scene units.
const DEPTH: [f32; 2] = [2.0, 6.0];
/// Range of the log scales: 0.003 to 0.03 scene units, half a pixel to four pixels at 640 pixels a row.
const LOG_SCALE: [f32; 2] = [-5.8, -3.5];
/// Range of the logit opacities: 0.12 to 0.98.
const LOGIT_OPACITY: [f32; 2] = [-2.0, 4.0];

/// The built-in Gaussians: they fill the camera's view in random order, and the left half is foreground. The code uses
/// no function whose result differs between machines.
fn random_gaussians(num_gaussians: usize, random: &mut Pcg64Mcg) -> Parameters {
    let mut g = BaseColumns::default();
    for _ in 0..num_gaussians {
        let z = random.random_range(DEPTH[0]..DEPTH[1]);
        let [x, y] = SLOPE.map(|slope| z * random.random_range(-slope..slope));
        g.means.push([x, y, z]);
        g.quats.push(std::array::from_fn(|_| random.random_range(-1.0..1.0)));
        g.log_scales.push(std::array::from_fn(|_| random.random_range(LOG_SCALE[0]..LOG_SCALE[1])));
        g.logit_opacities.push(random.random_range(LOGIT_OPACITY[0]..LOGIT_OPACITY[1]));
        g.colors.push(std::array::from_fn(|_| random.random_range(0.0..1.0)));
    }
    Parameters {
        foreground: g.means.iter().map(|mean| mean[0] < 0.0).collect(),
        gaussians: g.into(),
        mask_logits: vec![START_LOGIT; num_gaussians],
        camera_gains: vec![[0.0; 3]],
        camera_offsets: vec![[0.0; 3]],
    }
}

/// The built-in scene at every size.
pub fn built_in(num_gaussians: usize, sizes: &[Size], seed: u64) -> anyhow::Result<Vec<BenchScene>> {
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let parameters = random_gaussians(num_gaussians, &mut random);
    let state = later_timestep(parameters, &mut random)?;
    Ok(sizes
        .iter()
        .map(|&Size { width, height }| {
            let (ahead, up) = ([0.0, 0.0, 1.0], [0.0, -1.0, 0.0]);
            let camera = Camera::look_at([0.0; 3], ahead, up, FOCAL * width as f64, width, height);
            let mut image = Image::filled(width, height, 5, 0.0);
            for value in &mut image.data[..3 * width * height] {
                *value = f32::from(random.random::<u8>()) / 255.0;
            }
            for pixel in 0..width * height {
                let foreground = f32::from(u8::from(pixel % width < width / 2));
                image.plane_mut(3)[pixel] = foreground;
                image.plane_mut(4)[pixel] = 1.0 - foreground;
            }
            BenchScene { name: "random".into(), state: state.clone(), targets: vec![Target { camera, image }] }
        })
        .collect())
}

/// A capture's initial cloud and the training images of its first frame.
pub fn of_capture(capture: &Capture, downscale: usize, seed: u64) -> anyhow::Result<BenchScene> {
    let views = capture.views(Split::Train, 0, downscale)?;
    let parameters = Parameters::from_cloud(&capture.point_cloud()?, views.len(), START_LOGIT);
    let with_segmentation = views.iter().all(|view| view.segmentation.is_some());
    Ok(BenchScene {
        name: capture.name(),
        state: later_timestep(parameters, &mut Pcg64Mcg::seed_from_u64(seed))?,
        targets: views.iter().map(|view| Target::new(view, with_segmentation)).collect(),
    })
}

/// A state whose Gaussians have all moved a little since the timestep before, quantised to mixed bit widths.
pub fn later_timestep(parameters: Parameters, random: &mut Pcg64Mcg) -> anyhow::Result<State> {
    let q = TrainConfig::default().quantize;
    let mut state = State::new(parameters);
    state.canonicalize_quats();
    let p = &state.parameters;
    let mut bit_map = BitMap::uniform(p.num_gaussians(), BitSettings::default().position_bits, q.min_bits);
    for attribute in Attribute::BASE.into_iter().filter(|&attribute| attribute != Attribute::Mean) {
        bit_map.widths[attribute.index()].fill_with(|| random.random_range(q.min_bits..=q.max_bits));
    }
    let quantizers = FakeQuantizers::new(bit_map, &p.gaussians, q.learned_offset)?;
    state.start_quantization(quantizers);
    let mut moved = |by: f32| -> Vec<[f32; 3]> {
        let means = &state.parameters.gaussians.means();
        means.iter().map(|mean| mean.map(|x| x + random.random_range(-by..by))).collect()
    };
    let (first, before) = (moved(1e-2), moved(1e-3));
    let p = &state.parameters;
    let mut previous = p.gaussians.clone();
    previous.means_mut().copy_from_slice(&before);
    let first = Pose { means: first, quats: p.gaussians.quats().to_vec() };
    let past = Past::new(first, previous, &p.foreground);
    state.past = Some(Past { previous_mask_logits: Some(p.mask_logits.clone()), ..past });
    Ok(state)
}
