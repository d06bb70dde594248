//! Rendering and comparing with the images of a capture, image by image.

mod result;

use std::collections::BTreeMap;
use std::ops::Range;

use tcgs_capture::{Capture, Split};
use tcgs_core::{Image, View, upper_median};
use tcgs_metrics::{
    Backbone, InputRange, Lpips, Protocol, dssim, flicker, ms_ssim, psnr, psnr_masked, psnr_per_channel, ssim,
};
use tcgs_render::{DrawAny, RenderSettings};

use crate::observe::tell;
use crate::{Event, Observer, OpenScene, PipelineError, Work};

pub use result::{COLUMNS, MetricColumn, evaluation_json, protocol_mean};

/// Fewest renders that a median time is taken of.
const MIN_TIMED_RENDERS: usize = 9;

/// The inputs of [`evaluate`].
#[derive(Clone)]
pub struct EvaluateSettings<'a> {
    /// The cameras.
    pub split: Split,
    /// Frames of the capture; the scene has them.
    pub frames: Range<usize>,
    /// Factor by which the capture's images are shrunk.
    pub downscale: usize,
    /// Whether the first frame stands for all: the result of a scene without motion.
    pub frozen: bool,
    /// The network that measures LPIPS; none leaves LPIPS out.
    pub lpips: Option<&'a Lpips>,
    /// Protocol whose metrics are measured in addition.
    pub protocol: Option<Protocol>,
}

impl EvaluateSettings<'_> {
    /// All frames of a scene at the size it was trained with, without LPIPS and protocol.
    pub fn of(scene: &OpenScene, split: Split) -> Self {
        let (frames, downscale) = (scene.frames(), scene.downscale);
        Self { split, frames, downscale, frozen: false, lpips: None, protocol: None }
    }
}

/// Metrics of one image.
#[derive(Clone, Debug, PartialEq)]
pub struct ImageScore {
    /// Timestep of the scene.
    pub timestep: usize,
    /// The capture's number of the camera.
    pub camera: usize,
    /// All channels together, clamped, dB.
    pub psnr: f64,
    /// Mean over channels, not clamped, dB.
    pub psnr_per_channel: f64,
    /// SSIM of the clamped image; so are the metrics that follow.
    pub ssim: f64,
    /// MS-SSIM; none if the image is too small.
    pub ms_ssim: Option<f64>,
    /// DSSIM of [`Self::ms_ssim`].
    pub dssim: Option<f64>,
    /// LPIPS with VGG; none without weights, or if the image is too small.
    pub lpips_vgg: Option<f64>,
    /// LPIPS with AlexNet, under the same conditions.
    pub lpips_alex: Option<f64>,
    /// [`Self::psnr`] over the foreground alone; none without a mask or foreground.
    pub psnr_foreground: Option<f64>,
    /// The protocol's metrics, in its order; of the image as rendered.
    pub protocol: Vec<Option<f64>>,
}

/// The result of [`evaluate`].
#[derive(Clone, Debug, PartialEq)]
pub struct Evaluation {
    /// By time, then in the capture's order; at least one.
    pub images: Vec<ImageScore>,
    /// Mean over cameras and neighbouring frames; none for a single frame, or if nothing is static.
    pub flicker: Option<f64>,
    /// Width and height of the last image.
    pub size: [usize; 2],
    /// Time of one forward render at the evaluation size, decoded and warm. Colours by spherical harmonics are not
    /// included.
    pub median_render_ms: f64,
    /// The device that rendered.
    pub device: String,
    /// Whether gains and offsets of the capture changed the colours of its images. A protocol compares with the images
    /// that the cameras recorded.
    pub changed_colors: bool,
}

impl Evaluation {
    /// Mean of a metric over the images that have it; none if none has.
    pub fn mean(&self, metric: impl Fn(&ImageScore) -> Option<f64>) -> Option<f64> {
        ImageScore::mean(&self.images, metric)
    }
}

impl ImageScore {
    /// Mean of a metric over the images that have it; none if none has.
    pub fn mean<'a>(images: impl IntoIterator<Item = &'a Self>, metric: impl Fn(&Self) -> Option<f64>) -> Option<f64> {
        mean(images.into_iter().filter_map(metric))
    }
}

/// Mean; none of no values.
fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, count) = values.fold((0.0, 0), |(sum, count), value| (sum + value, count + 1));
    (count > 0).then(|| sum / f64::from(count))
}

/// Renders every camera of a split at every frame and compares with the capture's images.
///
/// # Errors
/// [`PipelineError::Frames`] if the scene lacks a frame, and [`PipelineError`] if the capture lacks a frame or such
/// cameras, or an image cannot be read; [`PipelineError::Stopped`] if the observer broke off.
pub fn evaluate(
    scene: &OpenScene,
    capture: &Capture,
    settings: &EvaluateSettings,
    renderer: &DrawAny,
    observer: &mut dyn Observer,
) -> Result<Evaluation, PipelineError> {
    let recorded = (settings.protocol.is_some() && capture.changes_colors()).then(|| capture.with_recorded_colors());
    let capture = recorded.as_ref().unwrap_or(capture);
    let EvaluateSettings { split, ref frames, downscale, frozen, .. } = *settings;
    scene.choose_frames(Some(frames))?;
    // The last frame is checked before the first is rendered.
    capture.cameras(split, frames.end - 1, downscale)?;
    let cameras = capture.cameras(split, frames.start, downscale)?;
    let num_steps = cameras.len() * frames.len();
    tell(observer, Event::Begun { work: Work::Evaluating, num_steps })?;
    let (mut images, mut flickers, mut times_ms) = (Vec::new(), Vec::new(), Vec::new());
    // Images of the previous frame, by camera: as rendered, and the target.
    let mut before: BTreeMap<usize, [Image; 2]> = BTreeMap::new();
    let mut drawn = scene.drawn(frames.start - scene.first_frame)?;
    let mut last_camera = None;
    for frame in frames.clone() {
        let timestep = frame - scene.first_frame;
        if !frozen && frame > frames.start {
            drawn = scene.drawn(timestep)?;
        }
        let mut now = BTreeMap::new();
        for view in capture.views(split, frame, downscale)? {
            let (output, ms) = renderer.draw(&drawn.seen_by(&view.camera), &view.camera, &RenderSettings::default())?;
            times_ms.push(ms);
            let clamped = clamped(&output.image);
            images.push(score(timestep, &output.image, &clamped, &view, settings));
            tell(observer, Event::Frame(frame))?;
            // Sizes may change with time; pixels then have no counterparts.
            let size = |image: &Image| (image.width, image.height);
            if let Some([rendered, image]) = before.get(&view.camera_id)
                && size(image) == size(&view.image)
            {
                flickers.push(flicker([rendered, &clamped], [image, &view.image]));
            }
            last_camera = Some(view.camera);
            now.insert(view.camera_id, [clamped, view.image]);
        }
        before = now;
    }
    let Some(camera) = last_camera else {
        let found = format!("has no such cameras in the frames {}..{}", frames.start, frames.end);
        return Err(PipelineError::input(capture.name(), found, "at least one"));
    };
    let seen = drawn.seen_by(&camera);
    while times_ms.len() < MIN_TIMED_RENDERS {
        times_ms.push(renderer.draw(&seen, &camera, &RenderSettings::default())?.1);
    }
    Ok(Evaluation {
        images,
        flicker: mean(flickers.into_iter().flatten()),
        size: [camera.width, camera.height],
        median_render_ms: upper_median(times_ms).unwrap_or_default(),
        device: renderer.name(),
        changed_colors: capture.changes_colors(),
    })
}

/// One image against the camera's.
fn score(timestep: usize, rendered: &Image, clamped: &Image, view: &View, settings: &EvaluateSettings) -> ImageScore {
    let image = &view.image;
    let lpips = |backbone| settings.lpips?.distance(backbone, InputRange::Signed, clamped, image);
    let ms_ssim = ms_ssim(clamped, image);
    ImageScore {
        timestep,
        camera: view.camera_id,
        psnr: psnr(clamped, image),
        psnr_per_channel: psnr_per_channel(rendered, image),
        ssim: ssim(clamped, image),
        ms_ssim,
        dssim: ms_ssim.map(dssim),
        lpips_vgg: lpips(Backbone::Vgg),
        lpips_alex: lpips(Backbone::Alex),
        psnr_foreground: view.segmentation.as_ref().and_then(|s| psnr_masked(clamped, image, &s.foreground)),
        protocol: settings.protocol.map_or_else(Vec::new, |p| p.measure(rendered, image, settings.lpips)),
    }
}

fn clamped(image: &Image) -> Image {
    Image { data: image.data.iter().map(|x| x.clamp(0.0, 1.0)).collect(), ..*image }
}
