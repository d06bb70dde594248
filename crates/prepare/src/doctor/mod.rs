//! The diagnosis of a capture: mistakes of cameras, masks and clocks that only the images reveal.
//!
//! A camera gets one of three verdicts: it fits, something is wrong, or the doctor cannot tell. Points with an assumed
//! depth are no evidence: points of the shell have their colour from one camera's own picture.
//!
//! What lives here: checks that [`Capture::open`] does not make.
//!
//! - *poses* finds cameras with one pose.
//! - *geometry* draws the points from every camera and compares the drawing with the image, for the given camera and
//!   for the usual mistakes.
//! - *masks* compares masks with the points' foreground.
//! - *colors* compares the cameras' colours with each other.
//! - *sync* compares each camera's silhouettes with those of the others at other frames.
//! - *sheet* draws the overview, *pictures* each camera for a page.
//!
//! What does not: missing or damaged files, which `open` and `views` report.

mod colors;
mod geometry;
mod masks;
mod pictures;
mod poses;
mod sheet;
mod splat;
mod sync;

use std::collections::BTreeMap;

use tcgs_capture::{Capture, Split};
use tcgs_core::{Camera, Image, View};

use crate::{PrepareError, StereoSettings, stereo};
use geometry::{Judged, Verdict};
use splat::Splats;

pub use pictures::CameraPictures;
pub use poses::same_poses;

/// Largest width at which images are compared, pixels.
const WIDTH: usize = 200;
/// Largest width at which images are searched for depth, pixels, where only the agreement matters.
const AGREEMENT_WIDTH: usize = 100;
/// Share of pixels on whose depth views agree, below which cameras may be wrong altogether.
const FEW_AGREE: f64 = 0.1;
/// Width of a camera's pictures at most, pixels.
const PICTURE_WIDTH: usize = 480;
/// Number of points that are made for a capture without points.
const NUM_POINTS: usize = 30_000;

/// The kinds of mistakes that [`check`] recognises.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum FindingKind {
    /// The capture gives `world_from_camera` where `camera_from_world` is expected.
    InvertedExtrinsics,
    /// Cameras have one pose.
    SamePose,
    /// Cameras have each other's poses and intrinsics.
    ExchangedCameras,
    /// The intrinsics belong to images of another size.
    ImageSize,
    /// The focal lengths are too large or too small.
    Focal,
    /// The principal point is displaced.
    PrincipalPoint,
    /// Image and points do not match, and none of the mistakes above explains it.
    NoFit,
    /// The mask has no foreground, although points of the foreground fall into the image.
    EmptyMask,
    /// The mask marks the background instead of the foreground.
    InvertedMask,
    /// The camera's colours are brighter or darker than those of the others.
    UnevenColors,
    /// The camera's frames are earlier or later than those of the other cameras.
    Unsynchronised,
}

impl FindingKind {
    /// The kind's name in snake case, as machine-readable reports hold it: `inverted_extrinsics`.
    pub fn name(self) -> &'static str {
        match self {
            Self::InvertedExtrinsics => "inverted_extrinsics",
            Self::SamePose => "same_pose",
            Self::ExchangedCameras => "exchanged_cameras",
            Self::ImageSize => "image_size",
            Self::Focal => "focal",
            Self::PrincipalPoint => "principal_point",
            Self::NoFit => "no_fit",
            Self::EmptyMask => "empty_mask",
            Self::InvertedMask => "inverted_mask",
            Self::UnevenColors => "uneven_colors",
            Self::Unsynchronised => "unsynchronised",
        }
    }
}

/// One mistake that [`check`] found. Displayed as one line: the cameras, the problem, the likely fix.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding {
    /// The kind of the mistake.
    pub kind: FindingKind,
    /// Ids of the cameras with this mistake.
    pub cameras: Vec<usize>,
    /// Names of these cameras.
    pub names: Vec<String>,
    /// The mistake, as the middle of a sentence.
    pub problem: String,
    /// The change to the capture that would likely correct the mistake.
    pub fix: String,
}

impl Finding {
    fn new(kind: FindingKind, cameras: Vec<usize>, problem: impl Into<String>, fix: impl Into<String>) -> Self {
        Self { kind, cameras, names: Vec::new(), problem: problem.into(), fix: fix.into() }
    }
}

impl std::fmt::Display for Finding {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let who = if self.cameras.len() == 1 { "camera" } else { "cameras" };
        write!(f, "{who} {}: {}; likely fix: {}", self.names.join(", "), self.problem, self.fix)
    }
}

/// Names of the cameras in messages, by id.
struct Names(BTreeMap<usize, String>);

impl Names {
    fn of(capture: &Capture) -> Result<Self, PrepareError> {
        let ids = capture.cameras(Split::All, 0, 1)?.into_iter().map(|(id, _)| id);
        Ok(Self(ids.zip(capture.camera_names(Split::All, 0)?).collect()))
    }

    fn name(&self, id: usize) -> &str {
        self.0.get(&id).map_or("?", String::as_str)
    }

    /// Names of cameras, separated by commas.
    fn list(&self, ids: &[usize]) -> String {
        ids.iter().map(|&id| self.name(id)).collect::<Vec<_>>().join(", ")
    }
}

/// How well the image of one camera matches the points drawn from its pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraFit {
    /// Id of the camera.
    pub camera_id: usize,
    /// Likeness: correlation of the image's colours with those of the points drawn from the camera, in `[-1, 1]`. A
    /// camera below [`Diagnosis::MIN_FIT`] is never said to fit. `None` where too few points or too little texture is
    /// in sight. Also `None` where all cameras share a mistake, and were therefore not compared one by one.
    pub fit: Option<f64>,
    /// Brightness of the camera's red, green and blue over those of the camera in the middle, after the gains of
    /// `capture.toml`. `None` where too little is in sight to compare, and for cameras that do not fit.
    pub brightness: Option<[f64; 3]>,
}

/// The result of [`check`].
#[derive(Clone, Debug)]
pub struct Diagnosis {
    /// The mistakes that were found; empty if the capture is correct or cannot be judged.
    pub findings: Vec<Finding>,
    /// Ids of the cameras that cannot be judged. Either the correct pose does not stand out from wrong poses, because
    /// image or points have too little texture or too few points with a measured depth are in sight. Or the likeness is
    /// below [`Self::MIN_FIT`].
    pub undecided: Vec<usize>,
    /// The fit of each training camera, then of each test camera.
    pub cameras: Vec<CameraFit>,
    /// Names of these cameras.
    pub names: Vec<String>,
    /// Share of the points whose depth is measured, the only evidence. `None` if the origin of the points is unknown.
    pub measured_share: Option<f64>,
    /// Whether the capture has no points of its own, so that the points were made by multi-view stereo.
    pub made_points: bool,
    /// Overview `[3, H, W]`: for each camera a tile with the projected points over the image, and below it the points
    /// drawn from the camera.
    pub sheet: Image,
    /// The points that were compared.
    splats: Splats,
}

impl Diagnosis {
    /// Correct cameras have a higher likeness than this ([`CameraFit::fit`]).
    pub const MIN_FIT: f64 = geometry::HEALTHY_FIT;

    /// The pictures of one camera, at most 480 pixels wide. Its image is read again.
    ///
    /// - `capture`: the examined capture
    /// - `place`: index into [`Self::cameras`]
    ///
    /// # Errors
    /// [`PrepareError`] if the image cannot be read.
    ///
    /// # Panics
    /// If there is no such camera.
    pub fn pictures(&self, capture: &Capture, place: usize) -> Result<CameraPictures, PrepareError> {
        let (_, camera) = &capture.cameras(Split::All, 0, 1)?[place];
        let downscale = camera.width.div_ceil(PICTURE_WIDTH).min(camera.height);
        let view = &capture.some_views(Split::All, 0, downscale, &[place])?[0];
        Ok(pictures::draw(view, &self.splats))
    }
}

/// Looks for wrong cameras, masks and clocks. Cameras and masks are compared with the points at the first frame, clocks
/// at frames spread over the capture.
/// - `capture`: opened by [`Capture::open_unseen`], so that wrong cameras give no error beforehand
/// - `report`: called with a description of each step before the step begins
///
/// ```
/// use tcgs_capture::{Capture, SyntheticSettings, write_synthetic};
/// use tcgs_prepare::check;
/// let folder = tempfile::tempdir()?;
/// write_synthetic(folder.path(), &SyntheticSettings { num_timesteps: 1, ..Default::default() })?;
///
/// let diagnosis = check(&Capture::open_unseen(folder.path())?, &mut |step| println!("{step}"))?;
/// assert!(diagnosis.findings.is_empty() && !diagnosis.made_points);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`PrepareError`] if images or points cannot be read. For a capture without points also if stereo cannot make
/// any from its cameras: fewer than three cameras, images too small, or directions too far apart.
pub fn check(capture: &Capture, report: &mut dyn FnMut(&str)) -> Result<Diagnosis, PrepareError> {
    report("reading images");
    let size = capture.cameras(Split::All, 0, 1)?;
    let widest = size.iter().map(|(_, camera)| camera.width).max().unwrap_or(1);
    let downscale = widest.div_ceil(WIDTH).max(1);
    let mut views = capture.views(Split::All, 0, downscale)?;
    let num_train = capture.cameras(Split::Train, 0, 1)?.len();

    let names = Names::of(capture)?;
    let mut findings = poses::findings(
        &views.iter().map(|view| view.camera_id).collect::<Vec<_>>(),
        &views.iter().map(|view| first_rows(&view.camera)).collect::<Vec<_>>(),
        &names,
    );
    let num_of_numbers = findings.len();
    let made_points = !capture.has_points();
    let (cloud, evidence, measured_share) = if made_points {
        stereo::check_enough(capture, &views[..num_train])?;
        findings.extend(masks::turn_over(capture, &mut views, downscale)?);
        let (views, finding) = consistent(&views[..num_train], report);
        findings.extend(finding);
        stereo::check_comparable(capture, &views)?;
        let settings = StereoSettings { num_points: NUM_POINTS, image_width: WIDTH, ..StereoSettings::default() };
        let prepared = stereo::cloud_of(&views, &settings, report);
        let evidence = prepared.measured();
        let share = evidence.points.len() as f64 / prepared.cloud.points.len().max(1) as f64;
        (prepared.cloud, evidence, Some(share))
    } else {
        (capture.point_cloud()?, capture.evidence()?, capture.measured_share()?)
    };
    report("comparing points with images");
    let (splats, evidence) = (Splats::new(&cloud), Splats::new(&evidence));
    // A mistake of all cameras was already reported, and the points are made with its correction.
    let is_judged = findings.len() == num_of_numbers;
    let may_accuse = measured_share.is_none() || !stereo::are_far_apart(&views[..num_train]);
    let judged = if is_judged { geometry::judge(&evidence, &views, downscale, may_accuse) } else { Vec::new() };
    findings.extend(geometry::findings(&views[..judged.len()], &judged, &names));
    report("comparing masks with points");
    findings.extend(masks::findings(&views, &splats));

    let suspects: Vec<usize> = findings.iter().flat_map(|finding| finding.cameras.iter().copied()).collect();
    report("comparing clocks");
    findings.extend(sync::findings(capture, &suspects)?);
    report("comparing colours");
    let brightness = colors::factors(&views, &evidence, &judged);
    findings.extend(colors::findings(&views, &brightness));
    for finding in &mut findings {
        finding.names = finding.cameras.iter().map(|&id| names.name(id).to_owned()).collect();
    }

    report("drawing the picture");
    let cameras: Vec<CameraFit> = (0..views.len())
        .map(|i| CameraFit {
            camera_id: views[i].camera_id,
            fit: judged.get(i).and_then(|judged| judged.fit),
            brightness: brightness[i],
        })
        .collect();
    let undecided = |judged: &&Judged| judged.verdict == Verdict::Undecided;
    let undecided = views.iter().zip(judged.iter()).filter(|(_, j)| undecided(j)).map(|(v, _)| v.camera_id).collect();
    let sheet = sheet::draw(&views, &splats, &findings);
    let names = cameras.iter().map(|camera| names.name(camera.camera_id).to_owned()).collect();
    Ok(Diagnosis { findings, undecided, cameras, names, measured_share, made_points, sheet, splats })
}

/// A camera's pose as a description has it.
fn first_rows(camera: &Camera) -> [[f64; 4]; 3] {
    let [a, b, c, _] = camera.camera_from_world;
    [a, b, c]
}

/// The views under the convention in which they agree best: as they are, or with all matrices inverted.
fn consistent(views: &[View], report: &mut dyn FnMut(&str)) -> (Vec<View>, Option<Finding>) {
    report("comparing images with each other");
    let with = |change: &dyn Fn(&Camera) -> Camera| -> Vec<View> {
        views.iter().map(|view| View { camera: change(&view.camera), ..view.clone() }).collect()
    };
    let given = stereo::agreement(views, AGREEMENT_WIDTH);
    if given >= FEW_AGREE {
        return (views.to_vec(), None);
    }
    let inverted = with(&Camera::inverse);
    if stereo::agreement(&inverted, AGREEMENT_WIDTH) > FEW_AGREE.max(2.0 * given) {
        let ids = views.iter().map(|view| view.camera_id).collect();
        let fix = "write the inverse of these matrices: w2c maps the world to the camera";
        let problem = "the matrix is the wrong way round (it maps the camera to the world)";
        return (inverted, Some(Finding::new(FindingKind::InvertedExtrinsics, ids, problem, fix)));
    }
    (views.to_vec(), None)
}

#[cfg(test)]
mod tests;
