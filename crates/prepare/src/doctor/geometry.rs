//! Checks whether cameras and images fit together. Every suspicion is a hypothesis: another pose or another lens, under
//! which the points would fall on pixels of their colours. A hypothesis that fits clearly better is the finding.

use rayon::prelude::*;
use tcgs_core::{Camera, Pinhole, View, distance, upper_median};

use super::splat::{Drawing, MIN_COVERAGE, Splats, smoothness};
use super::{Finding, FindingKind, Names};
use crate::stereo::vantage::Vantage;

/// Minimum gain in fit of a hypothesis over the given camera.
const CLEARLY: f64 = 0.12;
/// Minimum fit of a hypothesis that explains something.
const MIN_FIT: f64 = 0.35;
/// A camera below this fit does not fit, for whatever reason.
const NO_FIT: f64 = 0.2;
/// Healthy cameras fit better than this.
pub(super) const HEALTHY_FIT: f64 = 0.5;
/// A camera that no hypothesis explains is accused only if at least this share of the comparable cameras is healthy.
/// Otherwise the points are as suspect as the cameras.
const MOST: f64 = 0.5;
/// Minimum difference of two correlations, in standard deviations of wrong correlations. In the faults of the tests the
/// right hypothesis is at least 5.6 better than the given camera.
const SIGNIFICANT: f64 = 3.0;
/// Wrong shifts: steps in each direction, and share of the image's width between two.
const NULL_STEPS: i32 = 2;
const NULL_SPACING: f64 = 0.125;
/// Minimum number of wrong shifts from which their scatter is known.
const MIN_NULL: usize = 8;
/// Factors of the focal lengths that are tried.
const FOCAL_FACTORS: [f64; 16] =
    [0.25, 0.333, 0.4, 0.5, 0.571, 0.667, 0.75, 0.833, 0.91, 1.1, 1.2, 1.333, 1.5, 1.75, 2.0, 4.0];
/// Ratios of the image size that intrinsics may have been meant for.
const SIZE_FACTORS: [f64; 6] = [0.25, 0.333, 0.5, 2.0, 3.0, 4.0];
/// Largest shift of the principal point that is tried, share of the image's width.
const MAX_SHIFT: f64 = 0.25;
/// Calibrations err by up to this in the principal point, share of the image's width.
const MIN_SHIFT: f64 = 0.02;
/// Poses of cameras closer than this share of the rig's size cannot be told apart.
const MIN_APART: f64 = 0.02;

/// The fit of a camera, and a hypothesis that would fit better.
pub(super) struct Judged {
    /// `None` where there is too little to compare.
    pub fit: Option<f64>,
    pub verdict: Verdict,
}

/// The verdict on a camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Verdict {
    /// No hypothesis fits clearly better, and the likeness is high enough.
    Fits,
    /// This hypothesis fits better.
    Wrong(Hypothesis),
    /// Image and points do not fit, and no hypothesis explains the misfit.
    Lost,
    /// Too little texture, too few points or too little likeness to tell a right camera from a wrong one.
    Undecided,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Hypothesis {
    /// Inverted matrix.
    Inverted,
    /// Pose and lens of another camera.
    PoseOf(usize),
    /// Intrinsics times this factor.
    MeantForSize(f64),
    /// Focal lengths times this factor.
    Focal(f64),
    /// Principal point shifted by this, pixels of the capture's images.
    Principal([f64; 2]),
}

/// - `views`: in the size they are compared at
/// - `pixels_per`: pixels of the capture's images for one of those
/// - `may_accuse`: whether the points are evidence against a camera whose mistake is unknown
pub(super) fn judge(splats: &Splats, views: &[View], pixels_per: usize, may_accuse: bool) -> Vec<Judged> {
    let vantages: Vec<Vantage> = views.par_iter().map(|view| Vantage::new(view, 1)).collect();
    let drawings: Vec<_> = vantages.par_iter().map(|vantage| splats.draw(&vantage.pinhole)).collect();
    let point_smoothness = splats.smoothness();
    let typical_coverage = upper_median(drawings.iter().map(Drawing::coverage)).unwrap_or_default();
    let judged = (0..views.len())
        .into_par_iter()
        .map(|i| {
            let colors = &vantages[i].colors;
            let camera = &views[i].camera;
            let same_size = |j: usize| views[j].camera.width == camera.width && views[j].camera.height == camera.height;
            let given = drawings[i].fit(colors, [0; 2], 1);
            let fit = given.unwrap_or(0.0);
            let with = |camera: &Camera| splats.draw(&Pinhole::new(camera)).fit(colors, [0; 2], 1).unwrap_or(0.0);
            let mut best = (fit + CLEARLY, None);
            let mut consider = |fit: f64, hypothesis: Hypothesis, shift: [i32; 2]| {
                if fit > best.0 && fit > MIN_FIT {
                    best = (fit, Some((hypothesis, shift)));
                }
            };
            // From the likeliest hypothesis to the least likely: of two with the same fit the first is kept.
            consider(with(&camera.inverse()), Hypothesis::Inverted, [0; 2]);
            for j in (0..views.len()).filter(|&j| j != i && same_size(j) && is_apart(views, i, j)) {
                consider(drawings[j].fit(colors, [0; 2], 1).unwrap_or(0.0), Hypothesis::PoseOf(j), [0; 2]);
            }
            for factor in SIZE_FACTORS {
                consider(with(&scaled(camera, factor, factor)), Hypothesis::MeantForSize(factor), [0; 2]);
            }
            for factor in FOCAL_FACTORS {
                consider(with(&scaled(camera, factor, 1.0)), Hypothesis::Focal(factor), [0; 2]);
            }
            let most = (MAX_SHIFT * camera.width as f64) as i32;
            let (shift, shifted) = best_shift(most, |shift, step| drawings[i].fit(colors, shift, step).unwrap_or(0.0));
            if f64::from(shift[0]).hypot(f64::from(shift[1])) >= MIN_SHIFT * camera.width as f64 {
                let pixels = shift.map(|pixels| f64::from(pixels) * pixels_per as f64);
                consider(shifted, Hypothesis::Principal(pixels), shift);
            }
            // Upper bound of a right camera's correlation, from the noise in the points' colours and in the image.
            let attainable = (point_smoothness * smoothness(colors, camera.width)).sqrt();
            let verdict = match best {
                (better, Some((hypothesis, shift))) => {
                    let drawn = match hypothesis {
                        Hypothesis::Inverted => &splats.draw(&Pinhole::new(&camera.inverse())),
                        Hypothesis::PoseOf(j) => &drawings[j],
                        Hypothesis::MeantForSize(factor) => {
                            &splats.draw(&Pinhole::new(&scaled(camera, factor, factor)))
                        }
                        Hypothesis::Focal(factor) => &splats.draw(&Pinhole::new(&scaled(camera, factor, 1.0))),
                        Hypothesis::Principal(_) => &drawings[i],
                    };
                    let is_sure = attainable > MIN_FIT
                        && Null::of(drawn, colors, shift)
                            .is_some_and(|null| null.is_beaten_by(better) && null.tells_apart(better, fit.max(0.0)));
                    if is_sure { Verdict::Wrong(hypothesis) } else { Verdict::Undecided }
                }
                _ if given.is_some_and(|fit| fit >= NO_FIT) => Verdict::Fits,
                _ if given.is_none() => {
                    // Where the points fill the other cameras' images, a camera that sees few of them looks elsewhere.
                    let looks_elsewhere =
                        drawings[i].coverage() < MIN_COVERAGE && typical_coverage > 3.0 * MIN_COVERAGE;
                    if looks_elsewhere { Verdict::Lost } else { Verdict::Undecided }
                }
                _ => {
                    let healthy = HEALTHY_FIT * attainable;
                    match Null::of(&drawings[i], colors, [0; 2]) {
                        Some(null) if null.is_beaten_by(fit) && null.stands_out(fit) => Verdict::Fits,
                        Some(null) if null.tells_apart(healthy, fit) => Verdict::Lost,
                        _ => Verdict::Undecided,
                    }
                }
            };
            Judged { fit: given, verdict }
        })
        .collect();
    sober(judged, may_accuse)
}

/// Withdraws verdicts that the likeness of all cameras together does not support.
fn sober(mut judged: Vec<Judged>, may_accuse: bool) -> Vec<Judged> {
    let fits: Vec<f64> = judged.iter().filter_map(|judged| judged.fit).collect();
    let num_healthy = fits.iter().filter(|&&fit| fit > HEALTHY_FIT).count();
    let may_accuse = may_accuse && num_healthy as f64 >= MOST * fits.len() as f64;
    for of in &mut judged {
        let is_alike = of.fit.is_some_and(|fit| fit > HEALTHY_FIT);
        match of.verdict {
            Verdict::Fits if !is_alike => of.verdict = Verdict::Undecided,
            Verdict::Lost if !may_accuse => of.verdict = Verdict::Undecided,
            _ => {}
        }
    }
    judged
}

/// Correlations of points and image at wrong shifts: larger ones than the error of any calibration.
///
/// Smooth pictures of few things correlate with anything, so these correlations scatter widely. In a picture of much
/// texture they are all near zero. Their scatter, in Fisher's `atanh`, is the standard error of a correlation in this
/// picture. It does not depend on the number of pixels: it counts independent patches.
struct Null {
    /// `atanh` of the correlations.
    values: Vec<f64>,
    /// Standard deviation of the difference of two correlations, if every drawn point were an independent sample. Few
    /// points agree with anything in one of the many places that are tried.
    sampling: f64,
}

impl Null {
    /// `None` where too few of the shifts leave enough to compare.
    ///
    /// - `around`: the shift that is judged
    fn of(drawing: &Drawing, colors: &[[f32; 3]], around: [i32; 2]) -> Option<Self> {
        let spacing = (NULL_SPACING * drawing.width as f64).round().max(2.0) as i32;
        let shifts = (-NULL_STEPS..=NULL_STEPS).flat_map(|y| (-NULL_STEPS..=NULL_STEPS).map(move |x| [x, y]));
        let values: Vec<f64> = shifts
            .filter(|&shift| shift != [0; 2])
            .filter_map(|[x, y]| drawing.fit(colors, [around[0] + x * spacing, around[1] + y * spacing], 2))
            .map(fisher)
            .collect();
        let sampling = (2.0 / (drawing.num_points as f64 - 3.0).max(1.0)).sqrt();
        (values.len() >= MIN_NULL).then_some(Self { values, sampling })
    }

    /// Whether a correlation is larger than all wrong ones.
    fn is_beaten_by(&self, fit: f64) -> bool {
        self.values.iter().all(|&value| fisher(fit) > value)
    }

    /// Whether one correlation is larger than another by more than the error of both.
    fn tells_apart(&self, larger: f64, smaller: f64) -> bool {
        fisher(larger) - fisher(smaller) > SIGNIFICANT * self.scatter()
    }

    /// Whether a correlation is larger than wrong ones are on average, by more than their error.
    fn stands_out(&self, fit: f64) -> bool {
        fisher(fit) - self.mean() > SIGNIFICANT * self.scatter()
    }

    fn mean(&self) -> f64 {
        self.values.iter().sum::<f64>() / self.values.len() as f64
    }

    /// Error of a correlation: the standard deviation of wrong ones, or the sampling error of the number of points.
    fn scatter(&self) -> f64 {
        let (count, mean) = (self.values.len() as f64, self.mean());
        (self.values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / (count - 1.0)).sqrt().max(self.sampling)
    }
}

/// Fisher's transformation: the error of a transformed correlation does not depend on the correlation.
fn fisher(correlation: f64) -> f64 {
    correlation.clamp(-0.999, 0.999).atanh()
}

fn is_apart(views: &[View], i: usize, j: usize) -> bool {
    let centers: Vec<[f64; 3]> = views.iter().map(|view| view.camera.center()).collect();
    let size = centers.iter().map(|&center| distance(center, centers[0])).fold(0.0, f64::max);
    distance(centers[i], centers[j]) > MIN_APART * size
}

fn scaled(camera: &Camera, focal: f64, principal: f64) -> Camera {
    Camera {
        focal: camera.focal.map(|f| f * focal),
        principal: camera.principal.map(|c| c * principal),
        ..camera.clone()
    }
}

/// Coarse-to-fine search: steps of four pixels, then of one around the best.
fn best_shift(most: i32, fit: impl Fn([i32; 2], usize) -> f64) -> ([i32; 2], f64) {
    let search = |around: [i32; 2], reach: i32, spacing: i32, step: usize| {
        let mut best = (around, f64::NEG_INFINITY);
        let steps = reach / spacing;
        for dy in -steps..=steps {
            for dx in -steps..=steps {
                let shift = [around[0] + dx * spacing, around[1] + dy * spacing];
                let found = fit(shift, step);
                if found > best.1 {
                    best = (shift, found);
                }
            }
        }
        best
    };
    let (coarse, _) = search([0; 2], most, 4, 2);
    search(coarse, 4, 1, 1)
}

/// Findings about hypotheses; cameras with the same hypothesis share a finding.
pub(super) fn findings(views: &[View], judged: &[Judged], names: &Names) -> Vec<Finding> {
    let id = |i: usize| views[i].camera_id;
    let of = |pick: &dyn Fn(&Hypothesis) -> bool| -> Vec<usize> {
        (0..views.len()).filter(|&i| matches!(&judged[i].verdict, Verdict::Wrong(h) if pick(h))).map(id).collect()
    };
    let mut findings = Vec::new();
    let inverted = of(&|h| *h == Hypothesis::Inverted);
    if !inverted.is_empty() {
        let fix = "write the inverse of these matrices: w2c maps the world to the camera";
        let problem = "the matrix is the wrong way round (it maps the camera to the world)";
        findings.push(Finding::new(FindingKind::InvertedExtrinsics, inverted, problem, fix));
    }
    let exchanged = of(&|h| matches!(h, Hypothesis::PoseOf(_)));
    if !exchanged.is_empty() {
        let pairs: Vec<String> = (0..views.len())
            .filter_map(|i| match judged[i].verdict {
                Verdict::Wrong(Hypothesis::PoseOf(j)) => {
                    Some(format!("{} from that of {}", names.name(id(i)), names.name(id(j))))
                }
                _ => None,
            })
            .collect();
        let problem = format!("the image is what is seen from another camera's place: {}", pairs.join(", "));
        let fix = "bring images and cameras into the same order; sorted as text, 10 comes before 2";
        findings.push(Finding::new(FindingKind::ExchangedCameras, exchanged, problem, fix));
    }
    for factor in SIZE_FACTORS {
        let cameras = of(&|h| *h == Hypothesis::MeantForSize(factor));
        if !cameras.is_empty() {
            let problem = format!("the intrinsics are those of images {} times as large", shown(1.0 / factor));
            let fix = format!("multiply fx, fy, cx and cy by {}", shown(factor));
            findings.push(Finding::new(FindingKind::ImageSize, cameras, problem, fix));
        }
    }
    for factor in FOCAL_FACTORS {
        let cameras = of(&|h| *h == Hypothesis::Focal(factor));
        if !cameras.is_empty() {
            let problem = match factor < 1.0 {
                true => format!("the focal lengths are about {} times too large", shown(1.0 / factor)),
                false => format!("the focal lengths are about {} times too small", shown(factor)),
            };
            let fix = format!("multiply fx and fy by about {}, or calibrate again", shown(factor));
            findings.push(Finding::new(FindingKind::Focal, cameras, problem, fix));
        }
    }
    for i in 0..views.len() {
        if let Verdict::Wrong(Hypothesis::Principal([x, y])) = judged[i].verdict {
            let problem = format!("everything is seen {} of where the principal point puts it", direction([x, y]));
            let fix = format!("add about {x:.0} to cx and {y:.0} to cy, or calibrate again: it may be turned a little");
            findings.push(Finding::new(FindingKind::PrincipalPoint, vec![id(i)], problem, fix));
        }
    }
    let lost: Vec<usize> = (0..views.len()).filter(|&i| judged[i].verdict == Verdict::Lost).map(id).collect();
    if !lost.is_empty() {
        let problem = "image and points do not fit, and no single mistake explains it";
        let fix = format!("look at the picture and calibrate {} again", names.list(&lost));
        findings.push(Finding::new(FindingKind::NoFit, lost, problem, fix));
    }
    findings
}

/// Formats a number with two decimals at most.
fn shown(factor: f64) -> String {
    let text = format!("{factor:.2}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

fn direction([x, y]: [f64; 2]) -> String {
    let part = |value: f64, less: &str, more: &str| {
        (value != 0.0).then(|| format!("{:.0} px {}", value.abs(), if value < 0.0 { less } else { more }))
    };
    let parts: Vec<String> = [part(x, "left", "right"), part(y, "up", "down")].into_iter().flatten().collect();
    parts.join(" and ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn likeness_restrains_the_verdict() {
        let wrong = Verdict::Wrong(Hypothesis::Inverted);
        let sobered = |given: &[(f64, Verdict)], may_accuse: bool| -> Vec<Verdict> {
            let judged = given.iter().map(|&(fit, verdict)| Judged { fit: Some(fit), verdict }).collect();
            sober(judged, may_accuse).into_iter().map(|judged| judged.verdict).collect()
        };
        let verdicts = |given: &[(f64, Verdict)]| sobered(given, true);
        use Verdict::{Fits, Lost, Undecided};
        assert_eq!(verdicts(&[(0.9, Fits), (0.4, Fits), (0.8, Fits)]), [Fits, Undecided, Fits]);
        assert_eq!(verdicts(&[(0.9, Fits), (0.1, Lost), (0.8, Fits)]), [Fits, Lost, Fits]);
        assert_eq!(sobered(&[(0.9, wrong), (0.1, Lost), (0.8, Fits)], false), [wrong, Undecided, Fits]);
        // Where most cameras are unlike their points, the points are suspect.
        assert_eq!(verdicts(&[(0.6, Fits), (0.1, Lost), (0.3, Fits)]), [Fits, Undecided, Undecided]);
        assert_eq!(verdicts(&[(0.1, wrong), (0.2, wrong)]), [wrong, wrong]);
    }
}
