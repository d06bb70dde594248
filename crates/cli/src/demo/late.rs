//! Quality of the parts of the demo's scene that no camera saw at the first timestep.

use tcgs_capture::{Capture, Late, Split, SyntheticSettings};
use tcgs_core::{Image, View};
use tcgs_metrics::psnr_masked;
use tcgs_pipeline::OpenScene;
use tcgs_render::{DrawAny, RenderSettings};

/// Least number of pixels in an image for a meaningful PSNR.
const MIN_PIXELS: usize = 20;

/// The images of held-out cameras, in the order of their frames, and which of their pixels are late.
pub struct LateViews(Vec<(View, Late)>);

/// Mean PSNR over the images of held-out cameras that show late pixels, dB; NaN if no image does.
#[derive(Clone, Copy)]
pub struct LateQuality {
    /// PSNR over the pixels of objects that entered later.
    pub arrived: f64,
    /// PSNR over the pixels of static surfaces that were hidden.
    pub uncovered: f64,
}

impl LateViews {
    /// - `settings`: those that the capture was synthesised with
    pub fn of(capture: &Capture, settings: &SyntheticSettings) -> anyhow::Result<Self> {
        let mut all = Vec::new();
        for frame in 0..capture.num_frames() {
            for view in capture.views(Split::Test, frame, 1)? {
                let late = Late::in_view(settings, &view.camera, frame);
                all.push((view, late));
            }
        }
        Ok(Self(all))
    }

    /// - `scene`: covers all frames of the capture
    pub fn measure(&self, scene: &OpenScene, renderer: &DrawAny) -> anyhow::Result<LateQuality> {
        let (mut arrived, mut uncovered) = (Vec::new(), Vec::new());
        for of_frame in self.0.chunk_by(|(a, _), (b, _)| a.frame == b.frame) {
            let drawn = scene.drawn(of_frame[0].0.frame)?;
            for (view, late) in of_frame {
                let (output, _) =
                    renderer.draw(&drawn.seen_by(&view.camera), &view.camera, &RenderSettings::default())?;
                let image =
                    Image { data: output.image.data.iter().map(|x| x.clamp(0.0, 1.0)).collect(), ..output.image };
                for (mask, scores) in [(&late.arrived, &mut arrived), (&late.uncovered, &mut uncovered)] {
                    if mask.iter().filter(|late| **late).count() >= MIN_PIXELS {
                        scores.extend(psnr_masked(&image, &view.image, mask));
                    }
                }
            }
        }
        let mean = |scores: Vec<f64>| scores.iter().sum::<f64>() / scores.len() as f64;
        Ok(LateQuality { arrived: mean(arrived), uncovered: mean(uncovered) })
    }
}
