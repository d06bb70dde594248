//! Labels assign Gaussians of a file to objects. They are application data named [`LABELS`] (`docs/FORMAT.md`,
//! "Labels").

use serde::{Deserialize, Serialize};

/// Name of the application data that assign Gaussians to objects.
pub const LABELS: &str = "tcgs.labels";
/// Name of the object that marks the foreground of a capture.
pub const FOREGROUND: &str = "foreground";

/// Longest text that is parsed. Parsed runs take three times the memory of their text.
const MAX_BYTES: usize = 1 << 24;

/// Objects, and the Gaussians of each.
///
/// ```
/// use tcgs_codec::{FOREGROUND, LABELS, Labels, read_labels};
/// let labels = Labels::of_object(FOREGROUND, &[false, true, true, false]);
/// assert_eq!(labels.to_json(), br#"{"objects":["foreground"],"runs":[[1,-1],[2,0]]}"#);
/// let read = read_labels(&[(LABELS.to_owned(), labels.to_json())]).unwrap();
/// assert_eq!(read.members(FOREGROUND, 4), Some(vec![false, true, true, false]));
/// assert_eq!(read.members("ball", 4), None);
/// ```
#[derive(Clone, Debug, PartialEq, Eq, Deserialize, Serialize)]
pub struct Labels {
    objects: Vec<String>,
    /// Runs of Gaussians in the order of the file: length, and index of their object; -1 for no object.
    runs: Vec<(u32, i64)>,
}

impl Labels {
    /// A single object.
    ///
    /// - `members`: `[N]` whether each Gaussian belongs to it, in the order of the file
    pub fn of_object(name: &str, members: &[bool]) -> Self {
        let label = |run: &[bool]| (run.len() as u32, if run[0] { 0 } else { -1 });
        let mut runs: Vec<_> = members.chunk_by(|a, b| a == b).map(label).collect();
        // Gaussians after the last run belong to no object.
        runs.pop_if(|(_, label)| *label < 0);
        Self { objects: vec![name.into()], runs }
    }

    /// Encodes the labels as application data.
    pub fn to_json(&self) -> Vec<u8> {
        serde_json::to_vec(self).expect("texts and numbers are JSON")
    }

    /// Whether each Gaussian belongs to an object; `None` if no object has the name.
    ///
    /// - `num_gaussians`: `N`
    /// - returns: `[N]`, in the order of the file
    pub fn members(&self, name: &str, num_gaussians: usize) -> Option<Vec<bool>> {
        let object = self.objects.iter().position(|object| object == name)?;
        let mut members = Vec::with_capacity(num_gaussians);
        for &(count, label) in &self.runs {
            let end = members.len().saturating_add(count as usize).min(num_gaussians);
            members.resize(end, usize::try_from(label) == Ok(object));
        }
        members.resize(num_gaussians, false);
        Some(members)
    }
}

/// Objects of a scene; `None` if the file names none, or if its data are invalid.
///
/// - `data`: names and bytes of application data, in the order of the file
pub fn read_labels(data: &[(String, Vec<u8>)]) -> Option<Labels> {
    let (_, bytes) = data.iter().find(|(name, _)| name == LABELS).filter(|(_, bytes)| bytes.len() <= MAX_BYTES)?;
    let labels: Labels = serde_json::from_slice(bytes).ok()?;
    let is_object = |&(_, label): &(u32, i64)| (-1..labels.objects.len() as i64).contains(&label);
    labels.runs.iter().all(is_object).then_some(labels)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(json: &str) -> Option<Labels> {
        read_labels(&[("other".into(), Vec::new()), (LABELS.into(), json.as_bytes().to_vec())])
    }

    #[test]
    fn labels_of_several_objects_are_read() {
        let labels =
            read(r#"{ "objects": ["ball", "floor"], "runs": [[2, 0], [1, -1], [1, 1]], "more": {} }"#).unwrap();
        assert_eq!(labels.members("ball", 5), Some(vec![true, true, false, false, false]));
        assert_eq!(labels.members("floor", 5), Some(vec![false, false, false, true, false]));
        // A file that was cut has fewer Gaussians than its labels.
        assert_eq!(labels.members("ball", 1), Some(vec![true]));
        let endless = read(r#"{ "objects": ["ball"], "runs": [[4294967295, -1], [4294967295, 0]] }"#).unwrap();
        assert_eq!(endless.members("ball", 2), Some(vec![false; 2]));
    }

    #[test]
    fn labels_that_are_wrong_are_none() {
        for wrong in [
            r#"{ "objects": ["ball"], "runs": [[2, 1]] }"#,
            r#"{ "objects": ["ball"], "runs": [[2, -2]] }"#,
            r#"{ "objects": ["ball"], "runs": [[-1, 0]] }"#,
            r#"{ "objects": ["ball"], "runs": [[1]] }"#,
            r#"{ "runs": [[1, 0]] }"#,
            "",
        ] {
            assert_eq!(read(wrong), None, "{wrong}");
        }
        assert_eq!(read_labels(&[]), None);
    }

    #[test]
    fn every_choice_of_members_comes_back() {
        for bits in 0..64_u32 {
            let members: Vec<bool> = (0..6).map(|i| bits >> i & 1 == 1).collect();
            let labels = Labels::of_object("ball", &members);
            assert_eq!(read_labels(&[(LABELS.into(), labels.to_json())]), Some(labels.clone()));
            assert_eq!(labels.members("ball", 6), Some(members));
        }
    }
}
