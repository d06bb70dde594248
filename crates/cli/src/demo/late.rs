//! How well the demo shows what no camera saw at the first timestep.

use tcgs_capture::{Capture, Late, Split, SyntheticSettings};
use tcgs_core::Image;
use tcgs_metrics::psnr_masked;
use tcgs_pipeline::OpenScene;
use tcgs_render::{DrawAny, RenderSettings};

/// Fewer pixels of an image say little.
const MIN_PIXELS: usize = 20;

/// Mean PSNR over the images of held-out cameras that show some of it, dB; not a number if none does.
#[derive(Clone, Copy)]
pub struct LateQuality {
    /// Over the pixels of what has arrived.
    pub arrived: f64,
    /// Over the pixels of what stands still and was hidden.
    pub uncovered: f64,
}

impl LateQuality {
    /// - `settings`: of the capture, as it was synthesised
    pub fn measure(
        scene: &OpenScene,
        capture: &Capture,
        settings: &SyntheticSettings,
        renderer: &DrawAny,
    ) -> anyhow::Result<Self> {
        let (mut arrived, mut uncovered) = (Vec::new(), Vec::new());
        for frame in scene.frames() {
            let drawn = scene.drawn(frame - scene.first_frame)?;
            for view in capture.views(Split::Test, frame, 1)? {
                let (output, _) =
                    renderer.draw(&drawn.seen_by(&view.camera), &view.camera, &RenderSettings::default())?;
                let image =
                    Image { data: output.image.data.iter().map(|x| x.clamp(0.0, 1.0)).collect(), ..output.image };
                let late = Late::in_view(settings, &view.camera, frame);
                for (mask, scores) in [(&late.arrived, &mut arrived), (&late.uncovered, &mut uncovered)] {
                    if mask.iter().filter(|late| **late).count() >= MIN_PIXELS {
                        scores.extend(psnr_masked(&image, &view.image, mask));
                    }
                }
            }
        }
        let mean = |scores: Vec<f64>| scores.iter().sum::<f64>() / scores.len() as f64;
        Ok(Self { arrived: mean(arrived), uncovered: mean(uncovered) })
    }
}
