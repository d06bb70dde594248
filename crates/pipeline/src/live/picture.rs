//! Small files and pictures of a scene in training: made quickly, and not for keeping.

use tcgs_capture::Capture;
use tcgs_codec::{
    BitMap, CompactFile, CompressSettings, FileCamera, SceneInfo, UpAxis, VIEWS, compress_ordered, write_views,
};
use tcgs_core::{Camera, Drawable, DynamicGaussians, Gaussians, Life, Lives, View};
use tcgs_metrics::psnr;
use tcgs_render::{CpuRasterizer, Draw, RenderSettings};
use tcgs_train::{Parameters, TrainConfig, masked_out};

use crate::PipelineError;
use crate::compress::up_axis;
use crate::spread::spread;

/// Bits of a position's coordinate, and of any other number.
const POSITION_BITS: u8 = 16;
const BITS: u8 = 10;
/// Most cameras that a file gives players to start from.
const MAX_VIEWS: usize = 8;

/// Makes files and pictures of a run's scene.
#[derive(Debug)]
pub(super) struct Picture {
    name: String,
    up: UpAxis,
    first_frame: usize,
    frame_rate: f64,
    downscale: usize,
    /// Start cameras for players.
    views: Vec<u8>,
    /// Camera numbers of the capture's training cameras, in the order of their gains.
    camera_ids: Vec<usize>,
    /// Threshold below which a Gaussian is not drawn; none without masks.
    mask_threshold: Option<f32>,
}

impl Picture {
    /// - `cameras`: training cameras, with the capture's numbers
    pub fn new(config: &TrainConfig, capture: &Capture, cameras: &[(usize, Camera)]) -> Self {
        let view = |i: usize| FileCamera { name: cameras[i].0.to_string(), camera: cameras[i].1.clone() };
        Self {
            name: capture.name(),
            up: up_axis(cameras),
            first_frame: config.data.first_frame,
            frame_rate: config.data.frame_rate,
            downscale: config.data.downscale,
            views: write_views(&spread(cameras.len(), MAX_VIEWS).map(view).collect::<Vec<_>>()),
            camera_ids: cameras.iter().map(|(id, _)| *id).collect(),
            mask_threshold: config.mask.enabled.then_some(config.mask.threshold),
        }
    }

    /// Rows that are drawn.
    fn shown(&self, parameters: &Parameters) -> Vec<bool> {
        match self.mask_threshold {
            Some(threshold) => masked_out(&parameters.mask_logits, threshold).iter().map(|hidden| !hidden).collect(),
            None => vec![true; parameters.num_gaussians()],
        }
    }

    /// A `.tcgs` file of timesteps, without keypoints because these are slow to choose. It has the Gaussians that at
    /// least one of the timesteps draws.
    ///
    /// - `begin`: the first of the timesteps
    /// - `timesteps`: at least one. Each has the Gaussians of the one before, of which none has died, then those that
    ///   were born
    pub fn file(&self, begin: usize, timesteps: &[Parameters]) -> Result<Vec<u8>, PipelineError> {
        let last = timesteps.len() - 1;
        let n = timesteps[last].num_gaussians();
        let mut is_shown = vec![false; n];
        for parameters in timesteps {
            let shown = self.shown(parameters);
            is_shown.iter_mut().zip(shown).for_each(|(is_shown, shown)| *is_shown |= shown);
        }
        let keep: Vec<usize> = (0..n).filter(|&i| is_shown[i]).collect();
        let birth = |i: usize| timesteps.partition_point(|parameters| parameters.num_gaussians() <= i) as u32;
        let death = timesteps.len() as u32;
        let lives: Lives = keep.iter().map(|&i| Life { birth: birth(i), death }).collect();
        let all: Vec<&Gaussians> = timesteps.iter().map(|parameters| &parameters.gaussians).collect();
        let mut scene = DynamicGaussians::new(all[0].layout().clone());
        for timestep in 0..timesteps.len() {
            // A Gaussian that is not born yet stands as it will be born.
            let place = |(&i, life): (&usize, &Life)| (timestep.max(life.birth as usize), i);
            scene.push(Gaussians::gather(&all, &keep.iter().zip(lives.iter()).map(place).collect::<Vec<_>>()));
        }

        let info = SceneInfo {
            name: self.name.clone(),
            up: self.up,
            first_frame: (self.first_frame + begin) as u32,
            frame_rate: self.frame_rate as f32,
            downscale: self.downscale as u32,
            ..SceneInfo::of(&scene)
        };
        let bits = BitMap::uniform_of(scene.layout(), keep.len(), POSITION_BITS, BITS);
        let settings = CompressSettings { keypoints: false, ..CompressSettings::default() };
        let (compact, order) = compress_ordered(&scene, &bits, None, info, &settings)?;
        let compact = match lives.iter().any(|life| life.birth > 0) {
            true => compact.with_lives(lives.select(&order)),
            false => compact,
        };
        Ok(CompactFile::of(compact).encode(tcgs_codec::FORMAT_VERSION, &[(VIEWS, &self.views)])?)
    }

    /// PSNR in a view, dB. A training camera's gain and offset are applied to its view.
    pub fn psnr(&self, parameters: &Parameters, view: &View) -> f64 {
        let shown = self.shown(parameters);
        let rows: Vec<usize> = (0..shown.len()).filter(|&i| shown[i]).collect();
        let drawn = Drawable::new(&parameters.gaussians.select(&rows)).seen_by(&view.camera);
        let Ok(output) = CpuRasterizer.draw(&drawn, &view.camera, &RenderSettings::default());
        let mut image = output.0.image;
        if let Some(camera) = self.camera_ids.iter().position(|&id| id == view.camera_id) {
            image = parameters.seen_by_camera(camera, image);
        }
        psnr(&image, &view.image)
    }
}
