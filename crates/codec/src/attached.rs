//! Application data for players (`docs/FORMAT.md`, "Application data"): times of timesteps, light, background, credits,
//! sound. No decoder needs these data; a reader ignores data that are invalid.

use serde::{Deserialize, Serialize};
use tcgs_core::{Trust, length};

use crate::keypoints::{Selector, fit_values};

/// Name of the application data with the times of unevenly spaced timesteps.
pub const TIMES: &str = "tcgs.times";
/// Name of the application data with the credits of a scene.
pub const CREDITS: &str = "tcgs.credits";
/// Name of the application data with a soundtrack, an Ogg Opus stream.
pub const SOUND: &str = "tcgs.sound";
/// Name of the application data with the light on a scene over time.
pub const LIGHT: &str = "tcgs.light";
/// Name of the application data with the colour behind all Gaussians.
pub const BACKGROUND: &str = "tcgs.background";
/// Name of the application data with the positions from which pictures can be trusted.
pub const TRUST: &str = "tcgs.trust";

/// Gains that differ from 1 by less count as 1. Keypoint selection allows half of it as root mean square error.
const LEAST_CHANGE: f32 = 0.004;
/// Decimal places of gains in a file.
const PLACES: f64 = 1e4;

/// Longest text that is parsed: 65,536 times in microseconds take as much, and parsed JSON takes a multiple of its
/// text.
pub(crate) const MAX_BYTES: usize = 1 << 20;

/// Credits of a scene. A field that the file lacks is `None` or empty.
#[derive(Clone, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(default)]
pub struct Credits {
    /// An SPDX identifier, or any text.
    pub licence: Option<String>,
    /// Names of people.
    pub authors: Vec<String>,
    /// Origin of the scene: any text, often an address. It comes from the file, so it is untrusted.
    pub source: Option<String>,
}

/// The light on a scene over time: gains of red, green and blue, by which a renderer multiplies all colours. Gains are
/// linear between keypoints.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Light {
    /// `[K]` timesteps of the scene, strictly ascending; empty if the light is constant.
    timesteps: Vec<usize>,
    /// `[K]` red, green and blue, above 0.
    gains: Vec<[f32; 3]>,
}

impl Light {
    /// Chooses keypoints for the gains of all timesteps by the paper's Algorithm 1. The result has no keypoints if all
    /// gains are within 0.4 % of 1.
    ///
    /// - `gains`: `[T]`, finite and above 0
    ///
    /// ```
    /// use tcgs_codec::Light;
    /// let gains: Vec<[f32; 3]> = (0..9).map(|t| [1.0, 1.0, 1.0 - t as f32 / 64.0]).collect();
    /// let light = Light::through(&gains);
    /// assert_eq!(light.keypoints(), [(0, [1.0, 1.0, 1.0]), (8, [1.0, 1.0, 0.875])]);
    /// assert_eq!(light.at(4), [1.0, 1.0, 0.9375]);
    /// assert!(Light::through(&[[1.001; 3]; 9]).keypoints().is_empty());
    /// ```
    pub fn through(gains: &[[f32; 3]]) -> Self {
        if gains.as_flattened().iter().all(|gain| (gain - 1.0).abs() < LEAST_CHANGE) {
            return Self::default();
        }
        let channels: [Vec<f32>; 3] = [0, 1, 2].map(|c| gains.iter().map(|gain| gain[c]).collect());
        let max_error = f64::from(0.5 * LEAST_CHANGE).powi(2);
        let timesteps = Selector::default()
            .select_joint(&channels.each_ref().map(Vec::as_slice), &[1.0 / 3.0; 3], gains.len(), max_error)
            .to_vec();
        let values = channels.map(|channel| fit_values(&channel, &timesteps));
        let rounded = |value: f32| ((f64::from(value) * PLACES).round().max(1.0) / PLACES) as f32;
        let gains = (0..timesteps.len()).map(|k| [0, 1, 2].map(|c| rounded(values[c][k]))).collect();
        Self { timesteps, gains }
    }

    /// Timesteps and gains of the keypoints, ascending; empty if the light is constant.
    pub fn keypoints(&self) -> Vec<(usize, [f32; 3])> {
        self.timesteps.iter().copied().zip(self.gains.iter().copied()).collect()
    }

    /// The gains at a timestep of the scene; 1 if there are no keypoints. Gains are constant before the first and after
    /// the last keypoint.
    pub fn at(&self, timestep: usize) -> [f32; 3] {
        let after = self.timesteps.partition_point(|&t| t <= timestep);
        match (after.checked_sub(1), self.timesteps.get(after)) {
            (None, None) => [1.0; 3],
            (None, Some(_)) => self.gains[0],
            (Some(before), None) => self.gains[before],
            (Some(before), Some(&next)) => {
                let share = (timestep - self.timesteps[before]) as f32 / (next - self.timesteps[before]) as f32;
                let (from, to) = (self.gains[before], self.gains[after]);
                std::array::from_fn(|c| from[c] + share * (to[c] - from[c]))
            }
        }
    }

    /// Encodes the light as application data.
    pub fn to_json(&self) -> Vec<u8> {
        serde_json::to_vec(self).expect("numbers are JSON")
    }
}

/// Reads the light on a scene. It has no keypoints, and so is constant, if the data are missing or invalid.
///
/// - `data`: names and bytes of application data, in the order of the file
///
/// ```
/// use tcgs_codec::{LIGHT, read_light};
/// let json = br#"{ "timesteps": [0, 10], "gains": [[1, 1, 1], [0.9, 1, 1]] }"#;
/// assert_eq!(read_light(&[(LIGHT.to_owned(), json.to_vec())]).at(5), [0.95, 1.0, 1.0]);
/// assert_eq!(read_light(&[]).at(5), [1.0; 3]);
/// ```
pub fn read_light(data: &[(String, Vec<u8>)]) -> Light {
    let is_right = |light: &Light| {
        light.timesteps.len() == light.gains.len()
            && light.timesteps.is_sorted_by(|a, b| a < b)
            && light.gains.as_flattened().iter().all(|gain| gain.is_finite() && *gain > 0.0)
    };
    parse(data, LIGHT).filter(is_right).unwrap_or_default()
}

/// Times of the timesteps of a scene, in seconds from the first one. `None` if the file has no valid times: one for
/// each timestep, strictly ascending from 0.
///
/// - `data`: names and bytes of application data, in the order of the file
///
/// ```
/// use tcgs_codec::{TIMES, read_times};
/// let data = [(TIMES.to_owned(), br#"{ "seconds": [0.0, 0.04, 0.5] }"#.to_vec())];
/// assert_eq!(read_times(&data, 3), Some(vec![0.0, 0.04, 0.5]));
/// assert_eq!(read_times(&data, 4), None);
/// ```
pub fn read_times(data: &[(String, Vec<u8>)], num_timesteps: usize) -> Option<Vec<f64>> {
    #[derive(Deserialize)]
    struct Times {
        seconds: Vec<f64>,
    }
    let Times { seconds } = parse(data, TIMES)?;
    let ascends = seconds.is_sorted_by(|a, b| a < b) && seconds.iter().all(|s| s.is_finite());
    (seconds.len() == num_timesteps && seconds.first() == Some(&0.0) && ascends).then_some(seconds)
}

/// Credits of a scene; `None` if the file has none.
///
/// - `data`: names and bytes of application data, in the order of the file
///
/// ```
/// use tcgs_codec::{CREDITS, read_credits};
/// let data = [(CREDITS.to_owned(), br#"{ "licence": "CC-BY-4.0", "authors": ["A. Author"] }"#.to_vec())];
/// let credits = read_credits(&data).unwrap();
/// assert_eq!((credits.licence.as_deref(), credits.source), (Some("CC-BY-4.0"), None));
/// ```
pub fn read_credits(data: &[(String, Vec<u8>)]) -> Option<Credits> {
    parse(data, CREDITS)
}

/// The colour behind all Gaussians, in a file.
#[derive(Serialize, Deserialize)]
struct BackgroundInFile {
    color: [u8; 3],
}

/// Encodes the colour behind all Gaussians as application data.
///
/// - `color`: red, green and blue, sRGB of 255
pub fn write_background(color: [u8; 3]) -> Vec<u8> {
    serde_json::to_vec(&BackgroundInFile { color }).expect("numbers are JSON")
}

/// The colour behind all Gaussians: red, green and blue, sRGB of 255. It is black if the file does not say it, or says
/// it wrongly.
///
/// - `data`: names and bytes of application data, in the order of the file
///
/// ```
/// use tcgs_codec::{BACKGROUND, read_background};
/// let data = [(BACKGROUND.to_owned(), br#"{ "color": [118, 120, 103] }"#.to_vec())];
/// assert_eq!((read_background(&data), read_background(&[])), ([118, 120, 103], [0; 3]));
/// ```
pub fn read_background(data: &[(String, Vec<u8>)]) -> [u8; 3] {
    parse(data, BACKGROUND).map_or([0; 3], |BackgroundInFile { color }| color)
}

/// Positions from which pictures can be trusted, in a file: all angles in degrees.
#[derive(Serialize, Deserialize)]
struct TrustInFile {
    center: [f64; 3],
    /// From the centre to the nearest and to the farthest camera, scene units.
    distances: [f64; 2],
    /// Largest angle between two cameras between which pictures are trusted.
    between: f64,
    /// `[N, 3]` unit vectors from the centre to the cameras.
    directions: Vec<[f64; 3]>,
}

/// Most directions that are read.
const MAX_DIRECTIONS: usize = 256;
/// Greatest angle between two cameras between which pictures are trusted that is read, degrees.
const MAX_BETWEEN: f64 = 90.0;
/// Largest deviation of a direction's length from 1.
const MAX_LENGTH_ERROR: f64 = 0.01;

/// Encodes trust as application data. Lengths are rounded to four decimals in scene units, directions to three.
pub fn write_trust(trust: &Trust) -> Vec<u8> {
    let rounded = |x: f64, parts: f64| (x * parts).round() / parts;
    let in_file = TrustInFile {
        center: trust.center().map(|x| rounded(x, PLACES)),
        distances: trust.distances().map(|x| rounded(x, PLACES)),
        between: rounded(trust.between().to_degrees(), 1.0),
        directions: trust.directions().iter().map(|direction| direction.map(|x| rounded(x, 1e3))).collect(),
    };
    serde_json::to_vec(&in_file).expect("numbers are JSON")
}

/// The positions from which pictures of a scene can be trusted; `None` if the file does not say it, or says it wrongly.
///
/// - `data`: names and bytes of application data, in the order of the file
///
/// ```
/// use tcgs_codec::{TRUST, read_trust};
/// let json = br#"{ "center": [0, 0, 0], "distances": [2, 3], "between": 60, "directions": [[0, 0, -1]] }"#;
/// let trust = read_trust(&[(TRUST.to_owned(), json.to_vec())]).unwrap();
/// assert_eq!((trust.doubt([0.0, 0.2, -2.5]), trust.doubt([0.0, 0.0, 2.5])), (0.0, 1.0));
/// ```
pub fn read_trust(data: &[(String, Vec<u8>)]) -> Option<Trust> {
    let TrustInFile { center, distances, between, directions } = parse(data, TRUST)?;
    let is_unit = |direction: &[f64; 3]| (length(*direction) - 1.0).abs() <= MAX_LENGTH_ERROR;
    let is_right = center.iter().all(|x| x.is_finite())
        && 0.0 < distances[0]
        && distances[0] <= distances[1]
        && distances[1].is_finite()
        && (0.0..=MAX_BETWEEN).contains(&between)
        && (1..=MAX_DIRECTIONS).contains(&directions.len())
        && directions.iter().all(is_unit);
    let unit = |direction: [f64; 3]| direction.map(|x| x / length(direction));
    is_right.then(|| Trust::new(center, directions.into_iter().map(unit).collect(), distances, between.to_radians()))
}

/// Parses the first data of a name; `None` if they are not JSON of this form. Unknown fields are skipped.
fn parse<T: for<'a> Deserialize<'a>>(data: &[(String, Vec<u8>)], name: &str) -> Option<T> {
    let (_, bytes) = data.iter().find(|(of, _)| of == name)?;
    (bytes.len() <= MAX_BYTES).then(|| serde_json::from_slice(bytes).ok()).flatten()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn times(json: &str, num_timesteps: usize) -> Option<Vec<f64>> {
        read_times(&[("other".into(), Vec::new()), (TIMES.into(), json.as_bytes().to_vec())], num_timesteps)
    }

    #[test]
    fn times_that_are_wrong_are_none() {
        assert!(times(r#"{ "seconds": [0, 1, 2.5], "more": {} }"#, 3).is_some());
        for wrong in [
            r#"{ "seconds": [0, 1] }"#,
            r#"{ "seconds": [0.5, 1, 2] }"#,
            r#"{ "seconds": [0, 1, 1] }"#,
            r#"{ "seconds": [0, 2, 1] }"#,
            r#"{ "seconds": [0, 1, 1e999] }"#,
            r#"{ "seconds": [0, 1, null] }"#,
            r#"{ "seconds": 3 }"#,
            "[0, 1, 2]",
            "",
        ] {
            assert_eq!(times(wrong, 3), None, "{wrong}");
        }
        assert_eq!(times(&format!("{}{}", r#"{ "seconds": [0] }"#, " ".repeat(MAX_BYTES)), 1), None);
    }

    #[test]
    fn light_that_is_wrong_does_not_change() {
        let light = |json: &str| read_light(&[(LIGHT.into(), json.as_bytes().to_vec())]);
        assert_eq!(light(r#"{ "timesteps": [3], "gains": [[2, 1, 0.5]], "more": 1 }"#).at(0), [2.0, 1.0, 0.5]);
        for wrong in [
            r#"{ "timesteps": [0, 3], "gains": [[2, 1, 1]] }"#,
            r#"{ "timesteps": [3, 3], "gains": [[2, 1, 1], [1, 1, 1]] }"#,
            r#"{ "timesteps": [-1], "gains": [[2, 1, 1]] }"#,
            r#"{ "timesteps": [0], "gains": [[2, 1, 0]] }"#,
            r#"{ "timesteps": [0], "gains": [[2, 1, 1e99]] }"#,
            r#"{ "timesteps": [0], "gains": [[2, 1]] }"#,
            r#"{ "gains": [] }"#,
            "",
        ] {
            assert_eq!(light(wrong), Light::default(), "{wrong}");
        }
    }

    #[test]
    fn light_goes_through_its_gains_and_through_a_file() {
        // The light flickers, then fades.
        let gains: Vec<[f32; 3]> = (0..60)
            .map(|t| if t < 20 { [1.0 + 0.1 * (t % 2) as f32, 1.0, 1.0] } else { [1.0 - 0.004 * (t - 20) as f32; 3] })
            .collect();
        let light = Light::through(&gains);
        assert!(light.keypoints().len() < 30, "{light:?}");
        let error = |t: usize| (0..3).map(|c| (light.at(t)[c] - gains[t][c]).abs()).fold(0.0, f32::max);
        assert!((0..60).all(|t| error(t) < 3.0 * LEAST_CHANGE), "{light:?}");
        assert_eq!(read_light(&[(LIGHT.into(), light.to_json())]), light);
        assert_eq!(Light::through(&[[0.5; 3]]).at(7), [0.5; 3]);
    }

    #[test]
    fn a_background_that_is_wrong_is_black() {
        let background = |json: &[u8]| read_background(&[(BACKGROUND.into(), json.to_vec())]);
        assert_eq!(background(&write_background([0, 7, 255])), [0, 7, 255]);
        assert_eq!(background(br#"{ "color": [1, 2, 3], "more": 1 }"#), [1, 2, 3]);
        for wrong in ["[1, 2, 256]", "[1, 2]", "[1, 2, 3, 4]", "[-1, 2, 3]", "[0.5, 2, 3]", "\"#010203\""] {
            assert_eq!(background(format!("{{ \"color\": {wrong} }}").as_bytes()), [0; 3], "{wrong}");
        }
    }

    #[test]
    fn trust_goes_through_a_file_and_is_unknown_where_it_is_wrong() {
        let directions = vec![[0.0, 0.0, -1.0], [0.6, 0.0, -0.8], [0.0, -0.6, -0.8]];
        let trust = Trust::new([0.1, -2.0, 3.5], directions, [1.5, 2.25], 60_f64.to_radians());
        let read = |json: &str| read_trust(&[(TRUST.into(), json.as_bytes().to_vec())]);
        let json = String::from_utf8(write_trust(&trust)).unwrap();
        let again = read(&json).unwrap();
        assert_eq!((again.center(), again.distances()), (trust.center(), trust.distances()));
        for position in [[0.1, -2.0, 1.5], [1.1, -2.5, 2.0], [4.0, -2.0, 3.5]] {
            assert!((again.doubt(position) - trust.doubt(position)).abs() < 1e-2, "{position:?}");
        }
        for (right, wrong) in [
            ("[0.1,-2.0,3.5]", "[0.1,-2.0]"),
            ("[1.5,2.25]", "[2.5,2.25]"),
            ("[1.5,2.25]", "[0.0,2.25]"),
            ("[1.5,2.25]", "[1.5,1e999]"),
            ("60.0", "91"),
            ("60.0", "-1"),
            ("[0.6,0.0,-0.8]", "[0.6,0.0,0.0]"),
            ("[0.6,0.0,-0.8]", "[0.6,0.0,null]"),
        ] {
            assert!(json.contains(right), "{json}");
            assert_eq!(read(&json.replace(right, wrong)), None, "{wrong}");
        }
        assert_eq!(read(&json.replace("[[0.0,0.0,-1.0],[0.6,0.0,-0.8],[0.0,-0.6,-0.8]]", "[]")), None);
        let many = format!("[{}]", vec!["[0,0,-1]"; MAX_DIRECTIONS + 1].join(","));
        assert_eq!(read(&json.replace("[[0.0,0.0,-1.0],[0.6,0.0,-0.8],[0.0,-0.6,-0.8]]", &many)), None);
    }

    #[test]
    fn the_first_data_of_a_name_count() {
        let data = [r#"{ "source": 7 }"#, r#"{ "source": "here" }"#].map(|json| (CREDITS.to_owned(), json.into()));
        assert_eq!(read_credits(&data), None);
        assert_eq!(read_credits(&data[1..]).unwrap().source.as_deref(), Some("here"));
        assert_eq!(read_credits(&[(CREDITS.to_owned(), b"{}".to_vec())]), Some(Credits::default()));
    }
}
