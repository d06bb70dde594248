//! Known kinds of files of Gaussians without a reader here. A refusal names the kind.

use std::borrow::Cow;
use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use zip::ZipArchive;

use crate::sog::is_sog;

/// A file that no reader of this crate takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct UnreadKind {
    /// Its kind.
    pub name: &'static str,
    /// A readable file to use instead, for messages.
    pub expected: &'static str,
}

impl UnreadKind {
    /// Recognises a ZIP archive by the names of its entries. None if the kind is unknown, or if a reader may read it.
    ///
    /// ```
    /// use tcgs_interchange::UnreadKind;
    /// let folder = tempfile::tempdir()?;
    /// let path = folder.path().join("garden.zip");
    /// // An archive without entries.
    /// std::fs::write(&path, [b"PK\x05\x06".as_slice(), &[0; 18]].concat())?;
    /// assert_eq!(UnreadKind::of(&path).map(|kind| kind.name), Some("a ZIP archive without arrays of NumPy"));
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// An archive with an array of `NumPy` may be a `params.npz`; a damaged archive has no known kind.
    pub fn of(path: &Path) -> Option<Self> {
        let archive = ZipArchive::new(BufReader::new(File::open(path).ok()?)).ok()?;
        let names: Vec<String> = archive.file_names().flatten().map(Cow::into_owned).collect();
        let ends = |ending: &str| names.iter().any(|name| name.ends_with(ending));
        if ends(".npy") || is_sog(&names) {
            None
        } else if ends("data.pkl") {
            Some(Self {
                name: "a checkpoint of PyTorch",
                expected: "the PLY file or params.npz that its program writes",
            })
        } else {
            Some(Self { name: "a ZIP archive without arrays of NumPy", expected: "a params.npz" })
        }
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use zip::{ZipWriter, write::SimpleFileOptions};

    use super::*;

    /// An archive with empty files.
    fn archive(path: &Path, names: &[&str]) {
        let mut writer = ZipWriter::new(File::create(path).unwrap());
        for name in names {
            writer.start_file(*name, SimpleFileOptions::default()).unwrap();
            writer.write_all(b"").unwrap();
        }
        writer.finish().unwrap();
    }

    #[test]
    fn archives_are_known_by_their_entries() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        let name = |path: &Path| UnreadKind::of(path).map(|kind| kind.name);
        for (file, names, expected) in [
            ("a.zip", &["meta.json", "means_l.webp"][..], None),
            ("b.npz", &["scene/meta.json", "scene/quats.webp"], None),
            ("c.pth", &["archive/data.pkl", "archive/data/0"], Some("a checkpoint of PyTorch")),
            ("d.zip", &["readme.txt"], Some("a ZIP archive without arrays of NumPy")),
            ("e.npz", &["means3D.npy", "meta.json"], None),
        ] {
            archive(&path(file), names);
            assert_eq!(name(&path(file)), expected, "{file}");
        }
        for file in ["a.splat", "b.ksplat", "c.sog", "d.ply"] {
            std::fs::write(path(file), "PK\x03\x04").unwrap();
            assert_eq!(name(&path(file)), None, "{file}");
        }
        assert_eq!(name(folder.path()), None);
    }
}
