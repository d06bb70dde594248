//! Writes a scene as an animated USD file in text, `.usda`: one `ParticleField3DGaussianSplat` of `OpenUSD` 26.03 and
//! later.
//!
//! Attributes that no timestep changes are written once, the others with a sample for each timestep. Programs
//! interpolate between two samples of equal length, and hold samples of unequal length. Axes are y up and x right, as
//! `OpenUSD`'s cameras have them.

use std::io::{self, Write};
use std::ops::Range;

use tcgs_core::{Gaussians, SceneReader, normalize, sigmoid};

use crate::axes::Axes;
use crate::stored::{harmonics_in_rows, sh0_from_color};

/// Standard deviations of a Gaussian that count as its extent.
const EXTENT: f64 = 3.0;

/// An attribute that may vary with time.
struct Attribute {
    name: &'static str,
    /// Type of its elements.
    element: &'static str,
    /// Numbers of an element.
    components: usize,
    values: fn(&Gaussians) -> Vec<f32>,
}

const ATTRIBUTES: [Attribute; 5] = [
    Attribute {
        name: "positions",
        element: "point3f",
        components: 3,
        values: |gaussians| gaussians.means().as_flattened().to_vec(),
    },
    Attribute { name: "orientations", element: "quatf", components: 4, values: orientations },
    Attribute {
        name: "scales",
        element: "float3",
        components: 3,
        values: |gaussians| gaussians.log_scales().as_flattened().iter().map(|&x| x.exp().min(f32::MAX)).collect(),
    },
    Attribute {
        name: "opacities",
        element: "float",
        components: 1,
        values: |gaussians| gaussians.logit_opacities().iter().map(|&x| sigmoid(f64::from(x)) as f32).collect(),
    },
    Attribute {
        name: "radiance:sphericalHarmonicsCoefficients",
        element: "float3",
        components: 3,
        values: coefficients,
    },
];

/// Writes an animated USD file (`.usda`). Row `i` is the same Gaussian at all timesteps that have equally many. Further
/// columns than colours by harmonics are left out. The file does not say whether a scene is antialiased: USD has no
/// word for it.
///
/// - `writer`: should be buffered
/// - `scene`: stored form, in the axes of PLY files; every timestep is read several times, one is held. A logit of
///   negative infinity is an opacity of 0
/// - `first_frame`: the time code of timestep 0
/// - `frame_rate`: timesteps a second, above 0
///
/// ```
/// use tcgs_core::{DynamicGaussians, Gaussians};
/// use tcgs_interchange::write_usda_to;
/// let mut scene = DynamicGaussians::default();
/// for x in [0.0, 1.0] {
///     let mut gaussians = Gaussians::zeros(1);
///     gaussians.quats_mut()[0] = [1.0, 0.0, 0.0, 0.0];
///     gaussians.means_mut()[0][0] = x;
///     scene.push(gaussians);
/// }
/// let mut text = Vec::new();
/// write_usda_to(&mut text, &mut &scene, 7, 30.0)?;
/// let text = String::from_utf8(text)?;
/// assert!(text.contains("7: [(0, 0, 0)],") && text.contains("8: [(1, 0, 0)],"));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// The errors of `writer` and, as [`io::ErrorKind::Other`], of `scene`.
pub fn write_usda_to<R: SceneReader>(
    mut writer: impl Write,
    scene: &mut R,
    first_frame: usize,
    frame_rate: f64,
) -> io::Result<()> {
    let timesteps = 0..scene.num_timesteps();
    let survey = Survey::of(scene, timesteps.clone())?;
    let [low, high] = survey.extent.map(|corner| row(&corner));
    let degree = scene.layout().sh_degree();
    let last = first_frame + timesteps.len().saturating_sub(1);
    write!(
        writer,
        r#"#usda 1.0
(
    defaultPrim = "Scene"
    upAxis = "Y"
    metersPerUnit = 1
    startTimeCode = {first_frame}
    endTimeCode = {last}
    timeCodesPerSecond = {frame_rate}
    framesPerSecond = {frame_rate}
)

def Xform "Scene"
{{
    def ParticleField3DGaussianSplat "Gaussians"
    {{
        float3[] extent = [{low}, {high}]
        uniform int radiance:sphericalHarmonicsDegree = {degree}
        uniform token projectionModeHint = "perspective"
        uniform token sortingModeHint = "zDepth"
"#
    )?;
    for (attribute, varies) in ATTRIBUTES.iter().zip(survey.varies) {
        let Attribute { name, element, components, values } = attribute;
        let mut array = |writer: &mut dyn Write, timestep: usize| {
            let values = values(&turned(scene, timestep)?);
            writer.write_all(b"[")?;
            for (i, element) in values.chunks_exact(*components).enumerate() {
                let comma = if i > 0 { ", " } else { "" };
                write!(writer, "{comma}{}", row(element))?;
            }
            writer.write_all(b"]")
        };
        write!(writer, "        {element}[] {name}")?;
        if varies {
            writer.write_all(b".timeSamples = {\n")?;
            for timestep in timesteps.clone() {
                write!(writer, "            {}: ", first_frame + timestep)?;
                array(&mut writer, timestep)?;
                writer.write_all(b",\n")?;
            }
            writer.write_all(b"        }\n")?;
        } else {
            writer.write_all(b" = ")?;
            array(&mut writer, 0)?;
            writer.write_all(b"\n")?;
        }
    }
    writer.write_all(b"    }\n}\n")
}

/// Facts about all timesteps, for the first lines of the file.
struct Survey {
    /// Which attributes vary with time.
    varies: [bool; ATTRIBUTES.len()],
    /// Least and largest coordinates of all Gaussians at all timesteps.
    extent: [[f32; 3]; 2],
}

impl Survey {
    fn of<R: SceneReader>(scene: &mut R, timesteps: Range<usize>) -> io::Result<Self> {
        let mut survey =
            Self { varies: [false; ATTRIBUTES.len()], extent: [[f32::INFINITY; 3], [f32::NEG_INFINITY; 3]] };
        let mut first: Option<[Vec<f32>; ATTRIBUTES.len()]> = None;
        for timestep in timesteps {
            let gaussians = turned(scene, timestep)?;
            for (mean, log_scale) in gaussians.means().iter().zip(gaussians.log_scales()) {
                let reach = log_scale.iter().fold(0.0_f64, |most, &x| most.max(EXTENT * f64::from(x).exp()));
                for c in 0..3 {
                    let at =
                        |sign: f64| (f64::from(mean[c]) + sign * reach).clamp(f32::MIN.into(), f32::MAX.into()) as f32;
                    survey.extent[0][c] = survey.extent[0][c].min(at(-1.0));
                    survey.extent[1][c] = survey.extent[1][c].max(at(1.0));
                }
            }
            let values = ATTRIBUTES.each_ref().map(|attribute| (attribute.values)(&gaussians));
            match &first {
                None => first = Some(values),
                Some(first) => {
                    for (varies, (first, now)) in survey.varies.iter_mut().zip(first.iter().zip(&values)) {
                        *varies |= first != now;
                    }
                }
            }
        }
        Ok(survey)
    }
}

/// A timestep in the axes of the file.
fn turned<R: SceneReader>(scene: &mut R, timestep: usize) -> io::Result<Gaussians> {
    let mut gaussians = scene.at(timestep).map_err(io::Error::other)?;
    Axes::RUB.turn(&mut gaussians);
    Ok(gaussians)
}

/// Unit quaternions, w first. A rotation without a direction becomes the identity, as in renderers.
fn orientations(gaussians: &Gaussians) -> Vec<f32> {
    let unit = |quat: &[f32; 4]| match normalize(quat.map(f64::from)) {
        [0.0, 0.0, 0.0, 0.0] => [1.0, 0.0, 0.0, 0.0],
        unit => unit.map(|x| x as f32),
    };
    gaussians.quats().iter().flat_map(unit).collect()
}

/// Harmonic coefficients of each Gaussian, by degree and order; degree 0 is the colour.
fn coefficients(gaussians: &Gaussians) -> Vec<f32> {
    let mut harmonics = harmonics_in_rows(gaussians).into_iter();
    let num_further = 3 * ((gaussians.layout().sh_degree() + 1).pow(2) - 1);
    let mut all = Vec::with_capacity(gaussians.num_gaussians() * (3 + num_further));
    for color in gaussians.colors() {
        all.extend(color.map(sh0_from_color));
        all.extend(harmonics.by_ref().take(num_further));
    }
    all
}

/// An element as text: a number, or several in brackets. Every float is read back as it is.
fn row(element: &[f32]) -> String {
    // The shortest digits that tell a float from all others, without a zero behind the point. Zero has no sign.
    let number = |x: &f32| {
        let text = format!("{:?}", x + 0.0);
        text.strip_suffix(".0").map_or_else(|| text.clone(), Into::into)
    };
    match element {
        [x] => number(x),
        _ => format!("({})", element.iter().map(number).collect::<Vec<_>>().join(", ")),
    }
}

#[cfg(test)]
mod tests {
    use tcgs_core::DynamicGaussians;

    use super::*;

    fn text(scene: &DynamicGaussians) -> String {
        let mut bytes = Vec::new();
        write_usda_to(&mut bytes, &mut &*scene, 0, 24.0).unwrap();
        String::from_utf8(bytes).unwrap()
    }

    #[test]
    fn what_does_not_vary_is_written_once() {
        let mut scene = DynamicGaussians::default();
        for t in 0..3 {
            let mut gaussians = Gaussians::zeros(2);
            gaussians.quats_mut().fill([0.0, 2.0, 0.0, 0.0]);
            gaussians.means_mut()[1] = [0.1, 1e-9, t as f32];
            gaussians.logit_opacities_mut()[0] = if t == 1 { f32::NEG_INFINITY } else { 0.0 };
            scene.push(gaussians);
        }
        let text = text(&scene);
        for expected in [
            "positions.timeSamples = {\n            0: [(0, 0, 0), (0.1, -1e-9, 0)],",
            "opacities.timeSamples = {\n            0: [0.5, 0.5],\n            1: [0, 0.5],",
            "quatf[] orientations = [(0, 1, 0, 0), (0, 1, 0, 0)]\n",
            "float3[] scales = [(1, 1, 1), (1, 1, 1)]\n",
            "radiance:sphericalHarmonicsDegree = 0\n",
            "timeCodesPerSecond = 24\n",
            "extent = [(-3, -3, -5), (3.1, 3, 3)]\n",
        ] {
            assert!(text.contains(expected), "{expected:?} in {text}");
        }
    }
}
