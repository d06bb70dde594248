//! The checkpoints of a run as a chain of npz archives, one per timestep, each of which holds the changes.
//!
//! An archive's array `contents` is a text: `timestep T`, then a line for each array of the checkpoint:
//!
//! | line | the archive holds |
//! |---|---|
//! | `whole NAME` | `NAME`, as it is |
//! | `rows NAME` | the rows that differ in a bit: `NAME.rows`, their indices ([`pack_rows`]), and `NAME.values` |
//! | `same NAME` | nothing: the array is that of the timestep before |
//!
//! Rows run along the first axis and are compared with the timestep before. The reader searches for an array from its
//! timestep backwards to the archive that holds it whole. Every [`WHOLE_EVERY`]th archive holds all arrays whole. An
//! archive without `contents` holds all its arrays whole.

use std::collections::BTreeMap;
use std::io::{self, BufWriter, Seek, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use tcgs_interchange::{Existing, NpzReader, NpzWriter, write_whole};

use super::array::{Array, Arrays, Patch, pack_rows, problem_of, unpack_rows};
use crate::TrainError;

/// Distance of archives that hold everything whole. Resuming also needs the checkpoint before the last, which lies in
/// the same stretch or at the end of the one before. With the first and the last checkpoint at most 42 are read.
pub(crate) const WHOLE_EVERY: usize = 40;

const CONTENTS: &str = "contents";

/// The form in which an archive holds an array.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Form {
    Whole,
    Rows,
    Same,
}

impl Form {
    const ALL: [(Self, &str); 3] = [(Self::Whole, "whole"), (Self::Rows, "rows"), (Self::Same, "same")];
}

/// Reads and writes the archives of a folder. It remembers the last timestep read or written, from which alone the next
/// one is rebuilt.
#[derive(Debug)]
pub(crate) struct Chain {
    folder: PathBuf,
    only: Option<&'static [&'static str]>,
    last: Option<(usize, Arrays)>,
}

impl Chain {
    /// - `folder`: `checkpoints` of a run
    pub fn new(folder: &Path) -> Self {
        Self { folder: folder.into(), only: None, last: None }
    }

    /// For reading some arrays of every timestep.
    pub fn of(folder: &Path, names: &'static [&'static str]) -> Self {
        Self { only: Some(names), ..Self::new(folder) }
    }

    pub fn path(&self, timestep: usize) -> PathBuf {
        self.folder.join(format!("{timestep:06}.npz"))
    }

    /// Writes the archive of a timestep atomically: the changes from the timestep before, if that exists. Equal arrays
    /// give equal bytes, whatever was read or written before.
    ///
    /// - `order`: names of the arrays in the order of the archive
    ///
    /// # Errors
    /// [`TrainError::Write`] if the file cannot be written; as [`Self::read`] of the timestep before.
    pub fn write(&mut self, timestep: usize, order: &[String], arrays: Arrays) -> Result<(), TrainError> {
        let path = self.path(timestep);
        let has_before = !timestep.is_multiple_of(WHOLE_EVERY) && self.path(timestep - 1).is_file();
        let before = if has_before { self.read(timestep - 1)? } else { Arrays::new() };
        let written = write_whole(&path, Existing::Replace, |file| {
            write_link(BufWriter::new(file), timestep, order, &arrays, &before)
        });
        written.map_err(|error| TrainError::Write { path, error })?;
        self.last = Some((timestep, arrays));
        Ok(())
    }

    /// The arrays of a timestep.
    ///
    /// # Errors
    /// [`TrainError::File`] if the timestep's archive or one that it continues is missing or damaged.
    pub fn read(&mut self, timestep: usize) -> Result<Arrays, TrainError> {
        let mut found = Arrays::new();
        // By name, the patches of archives after the current one, latest first.
        let mut pending: BTreeMap<String, Vec<(PathBuf, Patch)>> = BTreeMap::new();
        for at in (0..=timestep).rev() {
            let path = self.path(at);
            let failed = |problem: String| TrainError::File { path: path.clone(), problem };
            let continued = |problem: String| match at {
                _ if at == timestep => failed(problem),
                _ => failed(format!("{problem}; {:06}.npz continues it", at + 1)),
            };
            if let Some((last, arrays)) = &self.last
                && *last == at
            {
                if at == timestep {
                    return Ok(arrays.clone());
                }
                for (name, patches) in std::mem::take(&mut pending) {
                    let array = arrays.get(&name).ok_or_else(|| continued(format!("{name} is missing")))?;
                    found.insert(name.clone(), patched(&name, array.clone(), patches)?);
                }
                break;
            }
            let mut link = Link::open(&path, at).map_err(continued)?;
            if at == timestep {
                let wanted = |name: &&String| self.only.is_none_or(|only| only.contains(&name.as_str()));
                pending = link.forms.keys().filter(wanted).map(|name| (name.clone(), Vec::new())).collect();
            }
            for name in pending.keys().cloned().collect::<Vec<_>>() {
                match link.forms.get(&name) {
                    Some(Form::Whole) => {
                        let array = Arc::new(Array::read(&mut link.npz, &name).map_err(continued)?);
                        let patches = pending.remove(&name).expect("its name was taken from there");
                        found.insert(name.clone(), patched(&name, array, patches)?);
                    }
                    Some(Form::Rows) => {
                        let patch = link.patch(&name).map_err(continued)?;
                        pending.get_mut(&name).expect("its name was taken from there").push((path.clone(), patch));
                    }
                    Some(Form::Same) => {}
                    None => return Err(continued(format!("{name} is missing"))),
                }
            }
            if pending.is_empty() {
                break;
            }
        }
        if let Some(name) = pending.keys().next() {
            return Err(TrainError::File {
                path: self.path(0),
                problem: format!("{name} is not whole, and nothing is before it"),
            });
        }
        self.last = Some((timestep, found.clone()));
        Ok(found)
    }
}

/// An array with the patches, latest first, of the files after it.
fn patched(name: &str, mut array: Arc<Array>, patches: Vec<(PathBuf, Patch)>) -> Result<Arc<Array>, TrainError> {
    for (path, patch) in patches.into_iter().rev() {
        let applied = Arc::make_mut(&mut array).apply(&patch);
        applied.map_err(|problem| TrainError::File { path, problem: format!("{name} {problem}") })?;
    }
    Ok(array)
}

/// One archive.
struct Link {
    npz: NpzReader,
    forms: BTreeMap<String, Form>,
}

impl Link {
    fn open(path: &Path, timestep: usize) -> Result<Self, String> {
        let mut npz = NpzReader::open(path).map_err(|error| format!("not a checkpoint: {}", problem_of(error)))?;
        if !npz.contains(CONTENTS) {
            let forms = npz.array_names().map(|name| (name, Form::Whole)).collect();
            return Ok(Self { npz, forms });
        }
        let text = npz.array_of::<u8>(CONTENTS).map_err(problem_of)?.values;
        let text = String::from_utf8(text).map_err(|_| "contents are no text")?;
        let mut lines = text.lines();
        let expected = format!("timestep {timestep}");
        match lines.next().unwrap_or_default() {
            found if found == expected => {}
            found => return Err(format!("holds {found}, expected {expected}")),
        }
        let mut forms = BTreeMap::new();
        for line in lines {
            let (form, name) = line.split_once(' ').unwrap_or_default();
            let form = Form::ALL.into_iter().find(|(_, word)| *word == form).map(|(form, _)| form);
            let form = form.ok_or_else(|| format!("contents have the line {line:?}, expected whole, rows or same"))?;
            forms.insert(name.to_owned(), form);
        }
        Ok(Self { npz, forms })
    }

    fn patch(&mut self, name: &str) -> Result<Patch, String> {
        let packed = self.npz.array_of::<u8>(&rows_name(name)).map_err(problem_of)?.values;
        let rows = unpack_rows(&packed).ok_or_else(|| format!("{} are no indices", rows_name(name)))?;
        Ok(Patch { rows, values: Array::read(&mut self.npz, &values_name(name))? })
    }
}

fn rows_name(name: &str) -> String {
    format!("{name}.rows")
}

fn values_name(name: &str) -> String {
    format!("{name}.values")
}

fn write_link<W: Write + Seek>(
    writer: W,
    timestep: usize,
    order: &[String],
    arrays: &Arrays,
    before: &Arrays,
) -> io::Result<()> {
    enum Held<'a> {
        Whole(&'a Array),
        Rows(Vec<u8>, Array),
        Same,
    }
    let held = |name: &String| {
        let array = &arrays[name];
        let Some(rows) = before.get(name).and_then(|before| array.changed_rows(before)) else {
            return Held::Whole(array);
        };
        if rows.is_empty() {
            return Held::Same;
        }
        let (packed, values) = (pack_rows(&rows), array.select(&rows));
        // An array that changes almost everywhere is stored whole, so that no earlier archive has to be read.
        if packed.len() + values.bytes() < array.bytes() { Held::Rows(packed, values) } else { Held::Whole(array) }
    };
    let held: Vec<(&String, Held<'_>)> = order.iter().map(|name| (name, held(name))).collect();
    let mut contents = format!("timestep {timestep}\n");
    for (name, held) in &held {
        let form = match held {
            Held::Whole(_) => Form::Whole,
            Held::Rows(..) => Form::Rows,
            Held::Same => Form::Same,
        };
        let word = Form::ALL.iter().find(|(known, _)| *known == form).expect("all are there").1;
        contents.push_str(&format!("{word} {name}\n"));
    }
    let mut npz = NpzWriter::new(writer);
    npz.array(CONTENTS, &[contents.len()], [contents.as_bytes()])?;
    for (name, held) in held {
        match held {
            Held::Whole(array) => array.write(&mut npz, name)?,
            Held::Rows(packed, values) => {
                npz.array(&rows_name(name), &[packed.len()], [&packed[..]])?;
                values.write(&mut npz, &values_name(name))?;
            }
            Held::Same => {}
        }
    }
    // A drop instead of `finish` would swallow the error of a full disk.
    npz.finish()?.flush()
}

/// Writes arrays atomically to an archive of their own, which names its timestep.
pub(crate) fn write_single(path: &Path, timestep: usize, order: &[String], arrays: &Arrays) -> Result<(), TrainError> {
    let written = write_whole(path, Existing::Replace, |file| {
        write_link(BufWriter::new(file), timestep, order, arrays, &Arrays::new())
    });
    written.map_err(|error| TrainError::Write { path: path.into(), error })
}

/// All arrays of an archive that [`write_single`] wrote.
///
/// # Errors
/// [`TrainError::File`] if the archive is missing, damaged or of another timestep.
pub(crate) fn read_single(path: &Path, timestep: usize) -> Result<Arrays, TrainError> {
    let read = || -> Result<Arrays, String> {
        let mut link = Link::open(path, timestep)?;
        let names: Vec<String> = link.forms.keys().cloned().collect();
        let of = |name: String| Ok((name.clone(), Arc::new(Array::read(&mut link.npz, &name)?)));
        names.into_iter().map(of).collect()
    };
    read().map_err(|problem| TrainError::File { path: path.into(), problem })
}
