//! Known kinds of files of Gaussians without a reader here. A refusal names the kind.

use std::borrow::Cow;
use std::fs::{self, File};
use std::io::BufReader;
use std::path::Path;

use zip::ZipArchive;

use crate::sog::is_sog;

/// A readable file to use instead of the kinds of this table, for messages.
const SPLAT_TRANSFORM: &str = "a PLY file, which splat-transform makes of it";

/// Kinds of files, by the endings of their names.
const ENDINGS: [(&str, &str); 1] = [("ksplat", "a .ksplat file of GaussianSplats3D")];
/// A folder with the content of a `.sog` file.
const SOG: UnreadKind =
    UnreadKind { name: "an unpacked SOG of SuperSplat", expected: "a .sog file, which splat-transform makes of it" };

/// A file, or a folder, that no reader of this crate takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct UnreadKind {
    /// Its kind.
    pub name: &'static str,
    /// A readable file to use instead, for messages.
    pub expected: &'static str,
}

impl UnreadKind {
    const fn of_splats(name: &'static str) -> Self {
        Self { name, expected: SPLAT_TRANSFORM }
    }

    /// Recognises a file by the ending of its name, a ZIP archive by the names of its entries, and a folder by the
    /// names of its files. None if the kind is unknown, or if a reader may read it.
    ///
    /// ```
    /// use tcgs_interchange::UnreadKind;
    /// let folder = tempfile::tempdir()?;
    /// let path = folder.path().join("garden.ksplat");
    /// std::fs::write(&path, "")?;
    /// assert_eq!(UnreadKind::of(&path).map(|kind| kind.name), Some("a .ksplat file of GaussianSplats3D"));
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn of(path: &Path) -> Option<Self> {
        if path.is_dir() {
            let entries = fs::read_dir(path).ok()?.filter_map(Result::ok);
            let names: Vec<String> = entries.map(|entry| entry.file_name().to_string_lossy().into_owned()).collect();
            return if is_sog(&names) {
                Some(SOG)
            } else {
                names.iter().find_map(|name| Self::of_ending(Path::new(name)))
            };
        }
        Self::of_ending(path).or_else(|| Self::of_archive(path)).or_else(|| {
            let is_table = path.file_name().is_some_and(|name| name == "meta.json");
            path.parent().filter(|_| is_table).and_then(Self::of).filter(|kind| *kind == SOG)
        })
    }

    fn of_ending(path: &Path) -> Option<Self> {
        let ending = path.extension()?;
        ENDINGS.iter().find(|(known, _)| ending.eq_ignore_ascii_case(known)).map(|(_, name)| Self::of_splats(name))
    }

    /// An archive with an array of `NumPy` may be a `params.npz`; a damaged archive has no known kind.
    fn of_archive(path: &Path) -> Option<Self> {
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
    fn files_are_known_by_name_and_by_content() {
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
        for (file, expected) in [
            ("a.splat", None),
            ("b.KSPLAT", Some("a .ksplat file of GaussianSplats3D")),
            ("c.sog", None),
            ("d.ply", None),
        ] {
            fs::write(path(file), "PK\x03\x04").unwrap();
            assert_eq!(name(&path(file)), expected, "{file}");
        }
    }

    #[test]
    fn folders_are_known_by_their_files() {
        let folder = tempfile::tempdir().unwrap();
        let table = folder.path().join("meta.json");
        fs::write(&table, "{}").unwrap();
        assert_eq!((UnreadKind::of(folder.path()), UnreadKind::of(&table)), (None, None));
        fs::write(folder.path().join("means_u.webp"), "").unwrap();
        for path in [folder.path(), &table] {
            assert_eq!(UnreadKind::of(path), Some(SOG));
        }
        let splats = tempfile::tempdir().unwrap();
        fs::write(splats.path().join("000.ksplat"), "").unwrap();
        assert_eq!(UnreadKind::of(splats.path()), Some(UnreadKind::of_splats("a .ksplat file of GaussianSplats3D")));
    }
}
