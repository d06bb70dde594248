//! What a run remembers of a timestep: its result, and the rest of what the next one starts from.
//! One NumPy archive a timestep, written whole or not at all.

use std::io::{BufWriter, Seek, Write};
use std::path::Path;

use tcgs_codec::{BitMap, Quantizer};
use tcgs_core::{Attribute, Gaussians, Layout};
use tcgs_interchange::{Existing, InterchangeError, NpyValue, NpzReader, NpzWriter, write_whole};

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
    /// Writes the archive, whole or not at all. Equal checkpoints are equal files.
    ///
    /// # Errors
    /// [`TrainError::Write`]; `path` is then as it was.
    pub fn save(&self, path: &Path, first: bool) -> Result<(), TrainError> {
        let written = write_whole(path, Existing::Replace, |file| self.write(BufWriter::new(file), first));
        written.map_err(|error| TrainError::Write { path: path.into(), error })
    }

    fn write<W: Write + Seek>(&self, writer: W, first: bool) -> std::io::Result<()> {
        let mut npz = NpzWriter::new(writer);
        let p = &self.parameters;
        let n = p.num_gaussians();
        for column in p.gaussians.layout().columns().iter().filter(|column| first || column.varies) {
            let attribute = column.attribute;
            let shape = [n, attribute.components()];
            let shape = if attribute.components() == 1 { &shape[..1] } else { &shape };
            npz.array(&column.name, shape, [p.gaussians.values(attribute)])?;
        }
        npz.array("mask_logits", &[n], [p.mask_logits.as_slice()])?;
        let flat = |q: &FakeQuantizers, f: fn(&Quantizer) -> f32| q.quantizers.iter().map(f).collect::<Vec<_>>();
        if let Some(q) = &self.quantizers {
            npz.array("quantizer_steps", &[q.quantizers.len()], [&flat(q, |q| q.step)[..]])?;
            npz.array("quantizer_offsets", &[q.quantizers.len()], [&flat(q, |q| q.offset)[..]])?;
        }
        for (name, m) in MOMENT_NAMES.iter().zip(&self.kept_moments) {
            npz.array(name, &[2, m.first.len()], [m.first.as_slice(), &m.second])?;
        }
        let kept_steps = self.kept_moments.each_ref().map(|m| m.step);
        npz.array("steps", &[self.steps.len() + kept_steps.len()], [self.steps.as_slice(), &kept_steps])?;
        if first {
            let cameras = p.camera_gains.len();
            npz.array("camera_gains", &[cameras, 3], [p.camera_gains.as_flattened()])?;
            npz.array("camera_offsets", &[cameras, 3], [p.camera_offsets.as_flattened()])?;
            npz.array("foreground", &[n], [&p.foreground.iter().map(|&f| u8::from(f)).collect::<Vec<_>>()[..]])?;
            npz.array("scene_radius", &[1], [[self.scene_radius].as_slice()])?;
            if let Some(q) = &self.quantizers {
                let groups: Vec<u8> = q.groups.iter().flat_map(|&(a, width)| [a.index() as u8, width]).collect();
                npz.array("quantizer_groups", &[q.groups.len(), 2], [&groups[..]])?;
                npz.array("quantizer_initial_steps", &[q.initial_steps.len()], [&q.initial_steps[..]])?;
                npz.array("bit_widths", &[5, n], q.bit_map.widths.iter().map(Vec::as_slice))?;
            }
        }
        // Left to be dropped, the archive would swallow a full disk.
        npz.finish()?.flush()
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
        let npz = NpzReader::open(path);
        let mut npz = npz.map_err(|error| failed(format!("not a checkpoint: {}", problem_of(error))))?;
        read(&mut npz, first, learned_offset).map_err(failed)
    }
}

fn read(npz: &mut NpzReader, first: Option<&Checkpoint>, learned_offset: bool) -> Result<Checkpoint, String> {
    let means = get::<f32>(npz, "means")?;
    let n = first.map_or(means.len() / 3, |f| f.parameters.num_gaussians());
    let mut gaussians = Gaussians::zeros(n);
    for column in Layout::base().columns() {
        let values = match first {
            Some(first) if !column.varies => first.parameters.gaussians.values(column.attribute).to_vec(),
            _ => get(npz, &column.name)?,
        };
        fill(&column.name, gaussians.values_mut(column.attribute), &values)?;
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

fn read_bits(npz: &mut NpzReader, n: usize) -> Result<Option<Bits>, String> {
    // All of them or none: an archive's list of names has no checksum.
    if !["quantizer_groups", "quantizer_initial_steps", "quantizer_steps", "bit_widths"].iter().any(|a| npz.contains(a))
    {
        return Ok(None);
    }
    let widths = get::<u8>(npz, "bit_widths")?;
    if widths.len() != 5 * n || widths.iter().any(|w| !(1..=16).contains(w)) {
        return Err(format!("bit_widths holds {} values, expected {} of 1 to 16", widths.len(), 5 * n));
    }
    let groups: Vec<(Attribute, u8)> = get::<u8>(npz, "quantizer_groups")?
        .chunks_exact(2)
        .map(|g| Attribute::BASE.get(usize::from(g[0])).filter(|_| (1..=16).contains(&g[1])).map(|&a| (a, g[1])))
        .collect::<Option<_>>()
        .ok_or("quantizer_groups names an attribute or a width that does not exist")?;
    let widths = std::array::from_fn(|a| widths[a * n..(a + 1) * n].to_vec());
    Ok(Some((BitMap { widths }, groups, get(npz, "quantizer_initial_steps")?)))
}

fn get<T: NpyValue>(npz: &mut NpzReader, name: &str) -> Result<Vec<T>, String> {
    Ok(npz.array_of(name).map_err(problem_of)?.values)
}

/// What is wrong with a checkpoint, without its path.
fn problem_of(error: InterchangeError) -> String {
    match error {
        InterchangeError::Io { error, .. } => error.to_string(),
        InterchangeError::Archive { problem, .. } => problem,
        InterchangeError::Array { key, problem, .. } => format!("{key} {problem}"),
        other => other.to_string(),
    }
}

fn fill(name: &str, into: &mut [f32], values: &[f32]) -> Result<(), String> {
    if into.len() != values.len() {
        return Err(format!("{name} holds {} values, expected {}", values.len(), into.len()));
    }
    into.copy_from_slice(values);
    Ok(())
}
