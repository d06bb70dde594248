//! Multi-view stereo sets of Middlebury (Seitz et al. 2006): a static object, one timestep.
//!
//! ```text
//! templeSR_par.txt        how many, then a line an image: name, k11 … k33, r11 … r33, t1 t2 t3
//! templeSR0001.png …      images
//! ```

use std::path::{Path, PathBuf};

use tcgs_core::Camera;

use super::test_cameras::every_eighth;
use crate::checked::{FrameRate, InnerPath};
use crate::contents::{CameraSetOfFiles, Contents};
use crate::footage::Change;
use crate::kind::{CaptureFacts, CaptureKind};
use crate::{CaptureError, decode, files, points};

/// Numbers of a line after the name.
const NUMBERS: usize = 21;

impl CaptureKind {
    /// Multi-view stereo sets of Middlebury: one timestep.
    pub const MIDDLEBURY: Self = Self {
        name: "middlebury",
        mark: "*_par.txt (Middlebury)",
        facts: CaptureFacts { has_floor: false, in_metres: false, labels_motion: false },
        recognises: |path| Ok(cameras_file(path)?.is_some()),
        open,
    };
}

/// The file of cameras.
fn cameras_file(path: &Path) -> Result<Option<PathBuf>, CaptureError> {
    Ok(files::list(path)?.into_iter().find(|file| files::name(file).ends_with("_par.txt")))
}

fn open(path: &Path) -> Result<Contents, CaptureError> {
    let file = cameras_file(path)?.ok_or_else(|| CaptureError::invalid(path, "has no *_par.txt"))?;
    let text = files::text(&file)?;
    let invalid = |problem: String| CaptureError::invalid(&file, problem);
    let mut lines = text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty());
    let count = lines.next().and_then(|(_, line)| line.trim().parse::<usize>().ok());
    let count = count.ok_or_else(|| invalid("line 1: expected the number of images".into()))?;
    let mut cameras = CameraSetOfFiles::new(path);
    cameras.begin_frame();
    let mut num_images = 0;
    for (i, line) in lines {
        let words: Vec<&str> = line.split_whitespace().collect();
        let numbers: Vec<f64> = words[1..].iter().filter_map(|word| word.parse().ok()).collect();
        let Some(n) = numbers.first_chunk::<NUMBERS>().filter(|_| words.len() == NUMBERS + 1) else {
            let problem =
                format!("line {}: expected a name and {NUMBERS} numbers: k11 … k33, r11 … r33, t1 t2 t3", i + 1);
            return Err(invalid(problem));
        };
        let name = InnerPath::new(words[0], "the capture")
            .map_err(|problem| invalid(format!("line {}: the name {problem}", i + 1)))?;
        let image = name.below(path);
        if !image.is_file() {
            let problem = format!("no such file, expected it as line {} of {} names it", i + 1, files::name(&file));
            return Err(CaptureError::invalid(image, problem));
        }
        let (width, height) = decode::size(&image)?;
        let k = std::array::from_fn(|r| std::array::from_fn(|c| n[3 * r + c]));
        let row = |r: usize| [n[9 + 3 * r], n[10 + 3 * r], n[11 + 3 * r], n[18 + r]];
        let camera = Camera::new(width, height, k, [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]])
            .map_err(|error| invalid(format!("line {}: {error}", i + 1)))?;
        cameras.add(num_images, camera, Change::Nothing, name);
        num_images += 1;
    }
    if num_images != count || count == 0 {
        return Err(invalid(format!("has {num_images} images, expected {count} as its first line says")));
    }
    let [train, test] = every_eighth(cameras.finish());
    Ok(Contents {
        num_frames: 1,
        frame_rate: FrameRate::USUAL,
        usual_frames: 0..1,
        train,
        test,
        cameras_files: [file.clone(), file],
        points: points::find(path, None),
    })
}
