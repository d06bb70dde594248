//! What is attached to a file for players (`docs/FORMAT.md`, "Application data"): times of timesteps, credits, sound. No decoder
//! needs these data, and a reader goes on without data that it finds wrong.

use serde::Deserialize;

/// Name of the application data that hold the times of timesteps that are not evenly apart.
pub const TIMES: &str = "tcgs.times";
/// Name of the application data that say whose work the scene is.
pub const CREDITS: &str = "tcgs.credits";
/// Name of the application data that are a sound to play along, an Ogg Opus stream.
pub const SOUND: &str = "tcgs.sound";

/// Longer texts are passed over: 65,536 times in microseconds take as much, and parsed JSON takes a multiple of its text.
const MAX_BYTES: usize = 1 << 20;

/// Whose work a scene is. What the file does not say is none or empty.
#[derive(Clone, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(default)]
pub struct Credits {
    /// An identifier of SPDX, or any text.
    pub licence: Option<String>,
    /// Names of people.
    pub authors: Vec<String>,
    /// Where the scene comes from: any text, often an address. It is a stranger's.
    pub source: Option<String>,
}

/// Times of the timesteps of a scene, in seconds from the first one; none if the file gives none that are right, which are
/// one for each timestep, strictly ascending from 0.
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

/// Whose work a scene is; none if the file does not say so.
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

/// The first data of a name, if they are JSON of this form. Fields that are not understood are skipped.
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
    fn the_first_data_of_a_name_count() {
        let data = [r#"{ "source": 7 }"#, r#"{ "source": "here" }"#].map(|json| (CREDITS.to_owned(), json.into()));
        assert_eq!(read_credits(&data), None);
        assert_eq!(read_credits(&data[1..]).unwrap().source.as_deref(), Some("here"));
        assert_eq!(read_credits(&[(CREDITS.to_owned(), b"{}".to_vec())]), Some(Credits::default()));
    }
}
