//! What is wrong with a capture, found by looking.
//!
//! What lives here: questions to images, cameras and masks that [`Capture::open`] cannot answer from numbers
//! alone. *geometry* compares points drawn from every camera with its image, as given and under the usual
//! mistakes; *masks* compares masks with the points' foreground; *sync* compares every camera's silhouettes
//! with what the others say at other times; *sheet* is the picture of it all. What does not: files that are
//! missing or damaged, which `open` and `views` name.

mod geometry;
mod masks;
mod sheet;
mod splat;
mod sync;

use tcgs_core::{Camera, Image, View};

use crate::{Capture, CaptureError, PrepareSettings, Split, points_in_view, prepare};
use geometry::{Judged, Verdict};
use splat::Splats;

/// Images are compared at this width at most, pixels.
const WIDTH: usize = 200;
/// Images are searched for depth at this width at most, pixels, where only the agreement matters.
const AGREEMENT_WIDTH: usize = 100;
/// Share of pixels on whose depth views agree, below which cameras may be wrong altogether.
const FEW_AGREE: f64 = 0.1;
/// Points, where the capture has none.
const NUM_POINTS: usize = 30_000;

/// Kinds of mistakes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum FindingKind {
    /// `camera_from_world` and `world_from_camera` are swapped.
    InvertedExtrinsics,
    /// Images stand at other cameras' places.
    ExchangedCameras,
    /// Intrinsics of larger or smaller images.
    ImageSize,
    /// Focal lengths too large or too small.
    Focal,
    /// Principal point too far to one side.
    PrincipalPoint,
    /// Image and points do not match, for no simple reason.
    NoFit,
    /// A mask without foreground, where foreground is in sight.
    EmptyMask,
    /// Foreground and background are swapped.
    InvertedMask,
    /// Frames are early or late.
    Unsynchronised,
}

impl FindingKind {
    /// One word for machines.
    pub fn name(self) -> &'static str {
        match self {
            Self::InvertedExtrinsics => "inverted_extrinsics",
            Self::ExchangedCameras => "exchanged_cameras",
            Self::ImageSize => "image_size",
            Self::Focal => "focal",
            Self::PrincipalPoint => "principal_point",
            Self::NoFit => "no_fit",
            Self::EmptyMask => "empty_mask",
            Self::InvertedMask => "inverted_mask",
            Self::Unsynchronised => "unsynchronised",
        }
    }
}

/// A mistake.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding {
    /// Which kind.
    pub kind: FindingKind,
    /// Whose, by the capture's names.
    pub cameras: Vec<usize>,
    /// What was found.
    pub problem: String,
    /// What would mend it.
    pub fix: String,
}

impl Finding {
    fn new(kind: FindingKind, cameras: Vec<usize>, problem: impl Into<String>, fix: impl Into<String>) -> Self {
        Self { kind, cameras, problem: problem.into(), fix: fix.into() }
    }
}

impl std::fmt::Display for Finding {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let who = if self.cameras.len() == 1 { "camera" } else { "cameras" };
        write!(f, "{who} {}: {}; likely fix: {}", list(&self.cameras), self.problem, self.fix)
    }
}

/// Numbers with commas between.
fn list(ids: &[usize]) -> String {
    ids.iter().map(usize::to_string).collect::<Vec<_>>().join(", ")
}

/// How one camera fits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraFit {
    /// By the capture's names.
    pub camera_id: usize,
    /// Correlation of its image with the points drawn from its place, -1 to 1; healthy cameras are above a half.
    /// Nothing where too few points or too little texture is in sight, and where all cameras are wrong in the same way
    /// and were not compared one by one.
    pub fit: Option<f64>,
}

/// What the doctor says.
#[derive(Clone, Debug)]
pub struct Diagnosis {
    /// What is wrong. Nothing, if the capture is healthy, or if it cannot be told.
    pub findings: Vec<Finding>,
    /// Cameras of which it cannot be told whether they are right, by the capture's names: image or points have too
    /// little texture, or too few points are in sight, for a right pose to stand out from wrong ones.
    pub undecided: Vec<usize>,
    /// Training cameras, then test cameras.
    pub cameras: Vec<CameraFit>,
    /// Whether the points were made for the purpose, for lack of others.
    pub made_points: bool,
    /// Every camera's image with projected points above the points drawn from its place.
    pub sheet: Image,
}

/// Looks for wrong cameras, masks and clocks.
///
/// - `report`: told what is done next
///
/// # Errors
/// If images or points cannot be read, or there are no points and cameras too far apart to make some.
pub fn check(capture: &Capture, report: &mut dyn FnMut(&str)) -> Result<Diagnosis, CaptureError> {
    report("reading images");
    let size = capture.cameras(Split::All, 0, 1)?;
    let widest = size.iter().map(|(_, camera)| camera.width).max().unwrap_or(1);
    let downscale = widest.div_ceil(WIDTH).max(1);
    let mut views = capture.views(Split::All, 0, downscale)?;
    let num_train = capture.cameras(Split::Train, 0, 1)?.len();

    let mut findings = Vec::new();
    let made_points = !capture.has_points();
    let cloud = if made_points {
        prepare::check_enough(capture, &views[..num_train])?;
        findings.extend(masks::turn_over(capture, &mut views, downscale)?);
        let (views, finding) = consistent(&views[..num_train], report);
        findings.extend(finding);
        prepare::check_comparable(capture, &views)?;
        let settings = PrepareSettings { num_points: NUM_POINTS, image_width: WIDTH, ..PrepareSettings::default() };
        prepare::cloud_of(&views, &settings, report).cloud
    } else {
        capture.point_cloud()?
    };
    report("comparing points with images");
    let splats = Splats::new(&cloud);
    // What is wrong with all of them was said, and the points are made for it.
    let judged = if findings.is_empty() { geometry::judge(&splats, &views, downscale) } else { Vec::new() };
    findings.extend(geometry::findings(&views[..judged.len()], &judged));
    report("comparing masks with points");
    findings.extend(masks::findings(&views, &splats));

    let suspects: Vec<usize> = findings.iter().flat_map(|finding| finding.cameras.iter().copied()).collect();
    report("comparing clocks");
    findings.extend(sync::findings(capture, &suspects)?);

    report("drawing the picture");
    let cameras = (0..views.len())
        .map(|i| CameraFit { camera_id: views[i].camera_id, fit: judged.get(i).and_then(|judged| judged.fit) })
        .collect();
    let undecided = |judged: &&Judged| judged.verdict == Verdict::Undecided;
    let undecided = views.iter().zip(judged.iter()).filter(|(_, j)| undecided(j)).map(|(v, _)| v.camera_id).collect();
    let sheet = sheet::draw(&views, &splats, &findings);
    Ok(Diagnosis { findings, undecided, cameras, made_points, sheet })
}

/// The views as they agree with each other best: as they are, or with all matrices inverted.
fn consistent(views: &[View], report: &mut dyn FnMut(&str)) -> (Vec<View>, Option<Finding>) {
    report("comparing images with each other");
    let with = |change: &dyn Fn(&Camera) -> Camera| -> Vec<View> {
        views.iter().map(|view| View { camera: change(&view.camera), ..view.clone() }).collect()
    };
    let given = prepare::agreement(views, AGREEMENT_WIDTH);
    if given >= FEW_AGREE {
        return (views.to_vec(), None);
    }
    let inverted = with(&points_in_view::inverse);
    if prepare::agreement(&inverted, AGREEMENT_WIDTH) > FEW_AGREE.max(2.0 * given) {
        let ids = views.iter().map(|view| view.camera_id).collect();
        let fix = "write the inverse of these matrices: w2c maps the world to the camera";
        let problem = "the matrix is the wrong way round (it maps the camera to the world)";
        return (inverted, Some(Finding::new(FindingKind::InvertedExtrinsics, ids, problem, fix)));
    }
    (views.to_vec(), None)
}

#[cfg(test)]
mod tests;
