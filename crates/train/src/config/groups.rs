//! The groups of settings: what each field means, and its default.

use serde::{Deserialize, Serialize};

/// The capture that a run trains on: folder, frames, resolution.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DataConfig {
    /// The capture's folder, as given.
    pub capture: String,
    /// Name of the capture's kind, by which evaluation follows the conventions of publications. Default `panoptic`.
    pub layout: String,
    /// File of the initial points; empty: the capture's own. Default empty.
    pub points: String,
    /// Names of cameras that training leaves out, so that they can judge it. Default none.
    pub hold_out: Vec<String>,
    /// Scene and timestep whose state the run starts from, as `/path/of/scene@12`; the first timestep is then trained
    /// as a later one. Empty: from points. Default empty.
    pub start_from: String,
    /// Index of the capture's frame that timestep 0 shows.
    pub first_frame: usize,
    /// One past the last frame.
    pub end_frame: usize,
    /// Images are averaged over this many pixels in both directions. Default 1.
    pub downscale: usize,
    /// Frames a second, for players.
    pub frame_rate: f64,
}

/// Numbers of iterations for which the constants of the reference are written: of the first timestep, and of each later
/// timestep.
pub const REFERENCE_ITERATIONS: [usize; 2] = [10_000, 2_000];

/// Numbers of iterations.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ScheduleConfig {
    /// Iterations of the first timestep. Default 10000 (reference).
    pub first_iterations: usize,
    /// Iterations of every later timestep. Default 2000 (reference).
    pub rest_iterations: usize,
}

/// Learning rates of Adam.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RateConfig {
    /// Means, times the scene's radius. Default 1.6e-4 (reference).
    pub mean: f32,
    /// Colours. Default 2.5e-3 (reference).
    pub color: f32,
    /// Adam's ε of all colours in the first timestep, as a share of the gradient of one pixel. It is multiplied by the
    /// sparsity of the views ([`view_sparsity`](crate::view_sparsity)). Gaussians that hardly show keep their first
    /// colours then. Reference 0; default 0.3.
    pub color_damping: f32,
    /// Coefficients of spherical harmonics, first timestep only. Default 1.25e-4, a twentieth of `color` (Kerbl et al.
    /// 2023).
    pub harmonic: f32,
    /// Colours after the first timestep. Reference 2.5e-3; default 5e-4, so that colours do not
    /// wander and their tracks stay simple.
    pub color_rest: f32,
    /// Rotations. Default 1e-3 (reference).
    pub quat: f32,
    /// Opacities, first timestep only. Default 0.05 (reference).
    pub logit_opacity: f32,
    /// Scales, first timestep only. Default 1e-3 (reference).
    pub log_scale: f32,
    /// Per-camera gain and offset, first timestep only. Default 1e-4 (reference). With `camera_centered` the rate is
    /// ten times as large if cameras differ in brightness by more than one level of 255 and 30 steps of the rate.
    pub camera: f32,
    /// Whether the cameras' gains have a (geometric) mean of 1 and their offsets a mean of 0, so that a camera that was
    /// not trained with sees the scene as it is. Reference false: a brightness that all cameras share may hide in them;
    /// default true.
    pub camera_centered: bool,
    /// Mask logits, at the reference's number of iterations; multiplied by reference / actual. Default 0.01.
    pub mask: f32,
    /// Learned steps, times the step they start from. Paper 0.02; default 0.002, with which values keep
    /// up with their steps: the faster rate costs 0.2 dB.
    pub step: f32,
    /// Factor of the means' and rotations' rates after the first timestep. 0 stands for reference iterations / actual,
    /// so that a short schedule can still follow fast motion. Default 0.
    pub motion_scale: f32,
    /// Whether Adam's bias correction starts again at every timestep. Reference false: the first steps
    /// are then about three times the rate. Default true, which follows motion better and drifts less.
    pub reset_steps: bool,
    /// Share of the rates of means, rotations, colours and steps left at the end of every timestep after
    /// the first, reached along a cosine. Reference 1: constant; default 0.02.
    pub motion_decay: f32,
    /// Likewise for every rate of the first timestep but the mask's. Reference 1; default 0.1.
    pub first_decay: f32,
    /// Factor of the rates of scales, rotations, means and cameras of the first timestep. 0 stands for the square root
    /// of reference iterations / actual. Reference 1; default 0.
    pub first_scale: f32,
}

/// Adaptive density control of the first timestep. Iterations are those of a 10000-iteration
/// schedule and scale with it; the interval does not.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DensifyConfig {
    /// First event. Default 500.
    pub start: usize,
    /// Iterations between events. Default 100.
    pub interval: usize,
    /// Mean NDC gradient from which a Gaussian is cloned or split. Reference 2e-4; default 3e-4, because antialiased
    /// splats have larger gradients.
    pub gradient_threshold: f32,
    /// Opacity below which a Gaussian is removed at the last event. Reference 0.25; default
    /// [`PRUNE_OPACITY`](Self::PRUNE_OPACITY), as at all other events.
    pub prune_opacity_end: f32,
    /// At this iteration opacities are reset, once; 0: they are not. Reference 3000; default 0.
    pub reset: usize,
    /// From this iteration on too large Gaussians are removed; 0: they are not. Reference 3000; default 0.
    pub prune_large: usize,
    /// Removes Gaussians that the training images hardly need, three times between the last event and the start of
    /// quantisation. Each time the mean squared error of these images may grow by this share; later iterations take
    /// most of it back. In a schedule of fewer than 1000 iterations the share is smaller in proportion. With
    /// sparse views ([`view_sparsity`](crate::view_sparsity)) it is up to three times as large. 0: none are removed.
    /// Reference 0; default 1.
    pub prune_error: f32,
    /// Share of the Gaussians that an iteration of the first timestep leaves out at random. It rises from 0 to this, and
    /// is multiplied by the sparsity of the views ([`view_sparsity`](crate::view_sparsity)). Reference 0; default 0.4.
    pub dropout: f32,
}

impl DensifyConfig {
    /// Opacity below which a Gaussian is removed at every event but the last. Reference.
    pub const PRUNE_OPACITY: f32 = 0.005;
}

/// Learned masks.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MaskConfig {
    /// Whether masks are learned. Reference true; default false, see [`DensifyConfig::prune_error`].
    pub enabled: bool,
    /// `ε` of Eq. 1 and of the final pruning. Default 0.01.
    pub threshold: f32,
    /// Logit that masks start from. Default 1.
    pub initial_logit: f32,
    /// Start every timestep from `initial_logit` (the authors' fork) instead of the timestep before. Default false.
    pub reset: bool,
    /// Iteration, of 10000, of the last pruning in the first timestep; what is masked later stays until all timesteps
    /// have voted. Reference 10000; default 6000, where quantisation starts.
    pub prune_end: usize,
}

/// The map from sensitivities to bit widths.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum BitMapKind {
    /// Least expected change of the images for `mean_bits` (`tcgs_codec::BitMapping::Log`).
    Log,
    /// The paper's min-max normalisation to `[min_bits, max_bits]` (`tcgs_codec::BitMapping::Linear`).
    Linear,
}

/// Quantisation inside the optimisation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct QuantizeConfig {
    /// Whether attributes are fake-quantised from `start` on.
    pub enabled: bool,
    /// Iteration, of 10000, at which sensitivities are measured and quantisation starts. Default 6000 (paper).
    pub start: usize,
    /// Fewest bits. Default 4 (paper).
    pub min_bits: u8,
    /// Most bits. Default 8 (paper).
    pub max_bits: u8,
    /// Mean bits of each attribute that the logarithmic map aims at. Default 5, about where the paper's [4, 8] ends up.
    pub mean_bits: f32,
    /// Sensitivity to bits. Default `log`; the paper's is `linear`.
    pub bit_map: BitMapKind,
    /// Whether quantizers learn an offset too (LSQ has none). Default true.
    pub learned_offset: bool,
}

/// Settings of the gate: what a timestep after the first trains.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GateConfig {
    /// Whether timesteps after the first train only what changes. Default true; false in `d3dgs` and `paper`.
    pub enabled: bool,
    /// A Gaussian is active if at least this share of its blending weight, over all views, falls on changed blocks.
    /// Default 0.4; 0 makes every Gaussian active that a changed block shows.
    pub share: f32,
    /// A timestep has settled when its losses fell, over the last pass through its views, by less than this share of
    /// the most that they fell over one pass. It then goes through the rest of its schedule faster. Default 0.2.
    pub settle: f32,
    /// Whether active Gaussians start where matches between a timestep's images and those before find them, instead of
    /// where they would be at constant velocity, if these explain the images much better. Default true; false in
    /// `d3dgs` and `paper`.
    pub matches: bool,
}

impl GateConfig {
    /// The settings of presets `default` and `fast`.
    pub const ON: Self = Self { enabled: true, share: 0.4, settle: 0.2, matches: true };

    /// The settings of presets that train everything, and of runs whose `config.toml` knows of no gate.
    pub const OFF: Self = Self { enabled: false, matches: false, ..Self::ON };
}

/// Settings of births: Gaussians that later timesteps add.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BirthConfig {
    /// Whether timesteps after the first add Gaussians where the scene does not explain what is seen. Needs the gate;
    /// a run that continues another one's state adds none.
    /// Default true; false in `d3dgs` and `paper`.
    pub enabled: bool,
    /// Most places at which Gaussians are born at a timestep, as a share of the Gaussians that there are. Default 0.02.
    pub share: f32,
    /// Iterations of a timestep in which they learn all their attributes, if all views see them. Default 200.
    pub iterations: usize,
    /// Timesteps after their birth in which they still learn all attributes, if the gate finds that they move or
    /// change. After these, opacity, scales and harmonics stay. Default 16.
    pub youth: usize,
    /// Mean NDC gradient from which a newborn is cloned or split after half of its iterations, with the other settings
    /// of `densify`; 0: none is. Default 6e-4.
    pub gradient_threshold: f32,
}

impl BirthConfig {
    /// The settings of presets `default` and `fast`.
    pub const ON: Self = Self { enabled: true, share: 0.02, iterations: 200, youth: 16, gradient_threshold: 6e-4 };

    /// The settings of presets that add none, and of runs whose `config.toml` knows of no births.
    pub const OFF: Self = Self { enabled: false, youth: 0, gradient_threshold: 0.0, ..Self::ON };
}

/// Settings of deaths: Gaussians that later timesteps remove.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DeathConfig {
    /// Timesteps in which no training camera sees a Gaussian, after which it dies. That is judged once in as many
    /// timesteps, so that it lives on for up to twice as many. A Gaussian at rest where it was born lives on, unless
    /// its mask hides it, because it may be uncovered, and cameras may move. Needs the gate; in a run that continues
    /// another one's state none dies. 0: none dies. Default 20; 0 in `d3dgs` and `paper`.
    pub patience: usize,
    /// A Gaussian is not seen if it makes up less than this share of the pixels of all training images of a timestep.
    /// Default 1e-6, below which `tcgs compress --refine` leaves it out of a file.
    pub share: f32,
}

impl DeathConfig {
    /// The settings of presets `default` and `fast`.
    pub const ON: Self = Self { patience: 20, share: 1e-6 };

    /// The settings of presets that remove none, and of runs whose `config.toml` knows of no deaths.
    pub const OFF: Self = Self { patience: 0, ..Self::ON };
}

/// Settings of colours that depend on the direction of view.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ColorConfig {
    /// Highest degree of spherical harmonics, 0 to 3; 0: a colour is the same from everywhere. Default 0 (reference).
    pub degree: usize,
}

/// Settings of what drawing does with the Gaussians, in training and ever after.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RenderConfig {
    /// Whether splats are antialiased: a splat that is widened to a pixel's extent loses as much opacity. The scene
    /// then looks the same at other resolutions than that of training (Yu et al. 2024, Mip-Splatting). A run that
    /// continues another scene follows that scene. Reference false; default true.
    pub antialiased: bool,
    /// Whether what lies behind all Gaussians has the colour that images have at their borders, instead of black. A run
    /// that continues another scene follows that scene. Reference false; default false, and true for captures of one
    /// frame.
    pub background: bool,
}

impl RenderConfig {
    /// As the reference draws.
    pub const OFF: Self = Self { antialiased: false, background: false };
}
