//! What a run remembers of a timestep: its result, and the rest of what the next one starts from.
//! One NumPy archive a timestep, written whole or not at all.

use std::io::{BufWriter, Write};
use std::path::Path;

use npyz::WriterBuilder;
use npyz::npz::{NpzArchive, NpzWriter};
use npyz::zip::write::FileOptions;
use npyz::zip::{CompressionMethod, DateTime};
use tcgs_codec::{BitMap, Quantizer};
use tcgs_core::{Attribute, Gaussians};

use crate::TrainError;
use crate::engine::cpu::{FakeQuantizers, Moments};
use crate::parameters::Parameters;

/// State at the end of one timestep.
#[derive(Clone, Debug, PartialEq)]
pub struct Checkpoint {
    /// Everything optimised. After the first timestep a file holds only what varies with time.
    pub parameters: Parameters,
    /// Quantisation, once it has started.
    pub quantizers: Option<FakeQuantizers>,
    /// Adam's moments that the next timestep goes on with: colours, quantizers' steps and offsets.
    pub kept_moments: [Moments; 3],
    /// Updates of the means, rotations and mask logits so far; their moments start anew.
    pub steps: [u64; 3],
    /// Scene units; see [`crate::scene_radius`].
    pub scene_radius: f32,
}

const MOMENT_NAMES: [&str; 3] = ["color_moments", "quantizer_step_moments", "quantizer_offset_moments"];

impl Checkpoint {
    /// Writes the archive beside `path`, makes it durable, then renames it.
    ///
    /// # Errors
    /// [`TrainError::Write`]; `path` is then as it was.
    pub fn save(&self, path: &Path, first: bool) -> Result<(), TrainError> {
        let failed = |error| TrainError::Write { path: path.into(), error };
        let folder = path.parent().unwrap_or(Path::new("."));
        let mut file = temporary_file(folder).map_err(failed)?;
        self.write(BufWriter::new(file.as_file_mut()), first).map_err(failed)?;
        file.as_file().sync_all().map_err(failed)?;
        file.persist(path).map_err(|e| failed(e.error))?;
        // The rename itself must survive a power cut too.
        std::fs::File::open(folder).and_then(|f| f.sync_all()).map_err(failed)
    }

    fn write<W: Write + std::io::Seek>(&self, writer: W, first: bool) -> std::io::Result<()> {
        let mut npz = NpzWriter::new(writer);
        let p = &self.parameters;
        let n = p.num_gaussians() as u64;
        for attribute in Attribute::ALL.into_iter().filter(|a| first || a.varies_in_training()) {
            let shape = [n, attribute.components() as u64];
            let shape = if attribute.components() == 1 { &shape[..1] } else { &shape };
            put(&mut npz, attribute.name(), shape, p.gaussians.values(attribute))?;
        }
        put(&mut npz, "mask_logits", &[n], &p.mask_logits)?;
        let flat = |q: &FakeQuantizers, f: fn(&Quantizer) -> f32| q.quantizers.iter().map(f).collect::<Vec<_>>();
        if let Some(q) = &self.quantizers {
            put(&mut npz, "quantizer_steps", &[q.quantizers.len() as u64], &flat(q, |q| q.step))?;
            put(&mut npz, "quantizer_offsets", &[q.quantizers.len() as u64], &flat(q, |q| q.offset))?;
        }
        for (name, m) in MOMENT_NAMES.iter().zip(&self.kept_moments) {
            put(&mut npz, name, &[2, m.first.len() as u64], &[m.first.as_slice(), &m.second].concat())?;
        }
        let steps = [self.steps.as_slice(), &self.kept_moments.each_ref().map(|m| m.step)].concat();
        put(&mut npz, "steps", &[steps.len() as u64], &steps)?;
        if first {
            let cameras = p.camera_gains.len() as u64;
            put(&mut npz, "camera_gains", &[cameras, 3], p.camera_gains.as_flattened())?;
            put(&mut npz, "camera_offsets", &[cameras, 3], p.camera_offsets.as_flattened())?;
            put(&mut npz, "foreground", &[n], &p.foreground.iter().map(|&f| u8::from(f)).collect::<Vec<_>>())?;
            put(&mut npz, "scene_radius", &[1], &[self.scene_radius])?;
            if let Some(q) = &self.quantizers {
                let groups: Vec<u8> = q.groups.iter().flat_map(|&(a, width)| [a.index() as u8, width]).collect();
                put(&mut npz, "quantizer_groups", &[q.groups.len() as u64, 2], &groups)?;
                put(&mut npz, "quantizer_initial_steps", &[q.initial_steps.len() as u64], &q.initial_steps)?;
                put(&mut npz, "bit_widths", &[5, n], &q.bit_map.widths.concat())?;
            }
        }
        // Left to be dropped, the archive would swallow a full disk.
        npz.zip_writer().finish().map_err(std::io::Error::from)?.flush()
    }

    /// Reads an archive.
    ///
    /// - `first`: the run's first checkpoint, which later ones take the rest from; `None` to read the first
    /// - `learned_offset`: of the run's settings
    ///
    /// # Errors
    /// [`TrainError::File`] if it is not a whole checkpoint of this run.
    pub fn load(path: &Path, first: Option<&Self>, learned_offset: bool) -> Result<Self, TrainError> {
        let failed = |problem: String| TrainError::File { path: path.into(), problem };
        let mut npz = NpzArchive::open(path).map_err(|e| failed(format!("not a checkpoint: {e}")))?;
        read(&mut npz, first, learned_offset).map_err(failed)
    }
}

/// A file to be renamed within `folder`. Temporary files are private unless told; the one it becomes is as
/// readable as any other.
pub(crate) fn temporary_file(folder: &Path) -> std::io::Result<tempfile::NamedTempFile> {
    let mut builder = tempfile::Builder::new();
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    builder.prefix(".writing-").tempfile_in(folder)
}

type Archive = NpzArchive<std::io::BufReader<std::fs::File>>;

fn read(npz: &mut Archive, first: Option<&Checkpoint>, learned_offset: bool) -> Result<Checkpoint, String> {
    let means = get::<f32>(npz, "means")?;
    let n = first.map_or(means.len() / 3, |f| f.parameters.num_gaussians());
    let mut gaussians = Gaussians::zeros(n);
    for attribute in Attribute::ALL {
        let values = match first {
            Some(first) if !attribute.varies_in_training() => first.parameters.gaussians.values(attribute).to_vec(),
            _ => get(npz, attribute.name())?,
        };
        fill(attribute.name(), gaussians.values_mut(attribute), &values)?;
    }
    let mut mask_logits = vec![0.0; n];
    fill("mask_logits", &mut mask_logits, &get::<f32>(npz, "mask_logits")?)?;
    let moments: Vec<Vec<f32>> = MOMENT_NAMES.iter().map(|name| get(npz, name)).collect::<Result<_, _>>()?;
    let steps = get::<u64>(npz, "steps")?;
    if steps.len() != 6 {
        return Err(format!("steps holds {} values, expected 6", steps.len()));
    }
    let kept_moments = std::array::from_fn(|i| {
        let (a, b) = moments[i].split_at(moments[i].len() / 2);
        Moments { first: a.to_vec(), second: b.to_vec(), step: steps[3 + i] }
    });

    let mut parameters = Parameters { gaussians, mask_logits, ..Parameters::default() };
    let (scene_radius, bits) = match first {
        Some(first) => {
            parameters.foreground = first.parameters.foreground.clone();
            parameters.camera_gains = first.parameters.camera_gains.clone();
            parameters.camera_offsets = first.parameters.camera_offsets.clone();
            let bits =
                first.quantizers.as_ref().map(|q| (q.bit_map.clone(), q.groups.clone(), q.initial_steps.clone()));
            (first.scene_radius, bits)
        }
        None => {
            parameters.foreground = get::<u8>(npz, "foreground")?.iter().map(|&f| f != 0).collect();
            parameters.camera_gains = get::<f32>(npz, "camera_gains")?.as_chunks().0.to_vec();
            parameters.camera_offsets = get::<f32>(npz, "camera_offsets")?.as_chunks().0.to_vec();
            let radius = get::<f32>(npz, "scene_radius")?.first().copied().ok_or("scene_radius is empty")?;
            (radius, read_bits(npz, n)?)
        }
    };
    if parameters.foreground.len() != n {
        return Err(format!("foreground holds {} values, expected {n}", parameters.foreground.len()));
    }
    let quantizers = match bits {
        None => None,
        Some((bit_map, groups, initial_steps)) => {
            let (steps, offsets) = (get::<f32>(npz, "quantizer_steps")?, get::<f32>(npz, "quantizer_offsets")?);
            let widths: Vec<u8> = groups.iter().flat_map(|&(a, width)| vec![width; a.components()]).collect();
            if [steps.len(), offsets.len(), initial_steps.len()] != [widths.len(); 3] {
                return Err(format!("{} quantizer steps, expected {}", steps.len(), widths.len()));
            }
            let quantizers: Vec<Quantizer> = (steps.iter().zip(&offsets).zip(&widths))
                .map(|((&step, &offset), &bits)| Quantizer { step, offset, bits })
                .collect();
            if let Some(problem) = quantizers.iter().find_map(Quantizer::problem) {
                return Err(format!("a quantizer is damaged: {problem}"));
            }
            Some(FakeQuantizers::restore(bit_map, groups, quantizers, initial_steps, learned_offset))
        }
    };
    Ok(Checkpoint { parameters, quantizers, kept_moments, steps: [steps[0], steps[1], steps[2]], scene_radius })
}

type Bits = (BitMap, Vec<(Attribute, u8)>, Vec<f32>);

fn read_bits(npz: &mut Archive, n: usize) -> Result<Option<Bits>, String> {
    if !npz.array_names().any(|name| name == "bit_widths") {
        return Ok(None);
    }
    let widths = get::<u8>(npz, "bit_widths")?;
    if widths.len() != 5 * n || widths.iter().any(|w| !(1..=16).contains(w)) {
        return Err(format!("bit_widths holds {} values, expected {} of 1 to 16", widths.len(), 5 * n));
    }
    let groups: Vec<(Attribute, u8)> = get::<u8>(npz, "quantizer_groups")?
        .chunks_exact(2)
        .map(|g| Attribute::ALL.get(usize::from(g[0])).filter(|_| (1..=16).contains(&g[1])).map(|&a| (a, g[1])))
        .collect::<Option<_>>()
        .ok_or("quantizer_groups names an attribute or a width that does not exist")?;
    let widths = std::array::from_fn(|a| widths[a * n..(a + 1) * n].to_vec());
    Ok(Some((BitMap { widths }, groups, get(npz, "quantizer_initial_steps")?)))
}

fn put<W: Write + std::io::Seek, T: npyz::Serialize + npyz::AutoSerialize + Copy>(
    npz: &mut NpzWriter<W>,
    name: &str,
    shape: &[u64],
    values: &[T],
) -> std::io::Result<()> {
    // No time of writing, so that equal checkpoints are equal files; not compressed, as `numpy.savez` does.
    let options = FileOptions::default()
        .compression_method(CompressionMethod::Stored)
        .last_modified_time(DateTime::default())
        .large_file(size_of_val(values) > u32::MAX as usize / 2);
    let mut array = npz.array::<T>(name, options)?.default_dtype().shape(shape).begin_nd()?;
    array.extend(values.iter().copied())?;
    array.finish()
}

fn get<T: npyz::Deserialize>(npz: &mut Archive, name: &str) -> Result<Vec<T>, String> {
    let array = npz.by_name(name).map_err(|e| format!("{name} cannot be read: {e}"))?;
    let array = array.ok_or_else(|| format!("{name} is missing"))?;
    array.into_vec().map_err(|e| format!("{name} cannot be read: {e}"))
}

fn fill(name: &str, into: &mut [f32], values: &[f32]) -> Result<(), String> {
    if into.len() != values.len() {
        return Err(format!("{name} holds {} values, expected {}", values.len(), into.len()));
    }
    into.copy_from_slice(values);
    Ok(())
}
