//! Checkpoints: the result of one timestep, and the optimiser's state that the next timestep starts from, as arrays.
//!
//! - `array`: one array, and the rows in which two differ
//! - `chain`: the archives of a run, which hold the changes from one timestep to the next

mod array;
mod chain;

use std::io::{BufWriter, Seek, Write};
use std::path::Path;
use std::sync::Arc;

use tcgs_codec::{BitMap, Quantizer};
use tcgs_core::{Activation, Attribute, Camera, Column, Gaussians, Layout, Life, Lives, RateGroup};
use tcgs_interchange::{Existing, NpzReader, NpzWriter, write_whole};

use self::array::{Array, Value, get, problem_of};
use crate::TrainError;
use crate::fake_quant::FakeQuantizers;
use crate::gate::GateRecord;
use crate::lifetimes::Lifetimes;
use crate::motion::Pose;
use crate::parameters::{Parameters, extent};
use crate::state::{Optimizer, goes_on};

pub(crate) use array::Arrays;
pub(crate) use chain::{Chain, read_single, write_single};

/// State at the end of one timestep.
#[derive(Clone, Debug, PartialEq)]
pub struct Checkpoint {
    /// All learned parameters, in stored form. The files after that of timestep 0 hold only what varies with time.
    pub parameters: Parameters,
    /// Identity, birth and death of each Gaussian.
    pub lifetimes: Lifetimes,
    /// The learned quantizers; `None` before quantisation has started.
    pub quantizers: Option<FakeQuantizers>,
    /// Adam's moments and counts that the next timestep continues; all others are zero.
    pub optimizer: Optimizer,
    /// Extent of the scene in scene units; see [`crate::scene_radius`].
    pub scene_radius: f32,
    /// The gate's record; empty in a run without a gate.
    pub gate: GateRecord,
    /// `[N]` timestep since which no camera has seen the Gaussian; [`Life::NEVER`] if one saw it last. Empty if deaths
    /// are off.
    pub unseen: Vec<u32>,
    /// Poses at birth of the Gaussians born after the first timestep, which are the last ones.
    pub born: Pose,
}

/// Name of the array with the moments of a column.
fn moments_name(column: &Column) -> String {
    // Files had this name before a layout could have further columns.
    if column.attribute == Attribute::Color { "color_moments".into() } else { format!("{}_moments", column.name) }
}

/// Name of the array with the values of a column. Further columns have a prefix, since their names are free.
fn values_name(column: &Column) -> String {
    match column.attribute {
        Attribute::Extra { .. } => format!("column_{}", column.name),
        _ => column.name.clone(),
    }
}

/// The columns whose moments go on to the next timestep.
fn with_moments(layout: &Layout) -> impl Iterator<Item = &Column> {
    layout.columns().iter().filter(|column| column.varies && goes_on(column))
}

/// The columns that vary and carry over only Adam's number of updates.
fn with_steps_alone(layout: &Layout) -> impl Iterator<Item = &Column> {
    layout.columns().iter().filter(|column| column.varies && !goes_on(column))
}

impl Checkpoint {
    /// The state of a scene of which only the Gaussians are known: none has a past, and nothing is quantised.
    ///
    /// - `cameras`: the training cameras, at least one
    pub fn of_parameters(parameters: Parameters, cameras: &[Camera]) -> Self {
        Self {
            lifetimes: Lifetimes::new(parameters.num_gaussians()),
            quantizers: None,
            optimizer: Optimizer::new(&parameters, 0),
            scene_radius: extent(cameras, parameters.gaussians.means()),
            parameters,
            gate: GateRecord::default(),
            unseen: Vec::new(),
            born: Pose::default(),
        }
    }

    /// Writes everything into one archive, atomically. Equal checkpoints give equal bytes.
    /// [`Run::save`](crate::Run::save) writes only the changes from the timestep before.
    ///
    /// - `first`: whether this is the checkpoint of timestep 0, which also holds everything that does not vary with
    ///   time
    ///
    /// # Errors
    /// [`TrainError::Write`] if the file cannot be written; `path` is then unchanged.
    pub fn save(&self, path: &Path, first: bool) -> Result<(), TrainError> {
        let written = write_whole(path, Existing::Replace, |file| self.write(BufWriter::new(file), first));
        written.map_err(|error| TrainError::Write { path: path.into(), error })
    }

    fn write<W: Write + Seek>(&self, writer: W, first: bool) -> std::io::Result<()> {
        let mut npz = NpzWriter::new(writer);
        for (name, _, array) in self.arrays(first) {
            array.write(&mut npz, &name)?;
        }
        // A drop instead of `finish` would swallow the error of a full disk.
        npz.finish()?.flush()
    }

    /// Name, use and values of everything that a checkpoint holds, in the order of the archive.
    ///
    /// - `first`: see [`Self::save`]
    pub(crate) fn arrays(&self, first: bool) -> Vec<(String, For, Array)> {
        let p = &self.parameters;
        let n = p.num_gaussians();
        let layout = p.gaussians.layout();
        let mut arrays = List::default();
        if first && !layout.is_base() {
            let table = table_of(layout);
            arrays.add("columns", For::Scene, &[table.len()], table.as_bytes());
        }
        if first && layout.is_antialiased() {
            arrays.add(ANTIALIASED, For::Scene, &[1], &[1_u8]);
        }
        if first && layout.background() != [0; 3] {
            arrays.add(BACKGROUND, For::Scene, &[3], &layout.background());
        }
        // A born Gaussian brings values of its own in all columns, and a dead one takes its values away.
        let has_lifetimes = !self.lifetimes.are_whole();
        for column in layout.columns().iter().filter(|column| first || has_lifetimes || column.varies) {
            let shape = [n, column.components()];
            let shape = if column.components() == 1 { &shape[..1] } else { &shape };
            arrays.add(&values_name(column), For::Scene, shape, p.gaussians.values(column.attribute));
        }
        if has_lifetimes {
            let l = &self.lifetimes;
            let (births, deaths): (Vec<u32>, Vec<u32>) = l.lives.iter().map(|life| (life.birth, life.death)).unzip();
            for (name, values) in LIFETIME_NAMES.into_iter().zip([&l.ids, &births, &deaths]) {
                arrays.add(name, For::Scene, &[values.len()], &wide(values));
            }
            let count = self.born.means.len();
            arrays.add(BORN_MEANS, For::Resuming, &[count, 3], self.born.means.as_flattened());
            arrays.add(BORN_QUATS, For::Resuming, &[count, 4], self.born.quats.as_flattened());
        }
        arrays.add(MASK_LOGITS, For::Scene, &[n], &p.mask_logits);
        let flat = |q: &FakeQuantizers, f: fn(&Quantizer) -> f32| q.quantizers.iter().map(f).collect::<Vec<_>>();
        if let Some(q) = &self.quantizers {
            arrays.add("quantizer_steps", For::Scene, &[q.quantizers.len()], &flat(q, |q| q.step));
            arrays.add("quantizer_offsets", For::Scene, &[q.quantizers.len()], &flat(q, |q| q.offset));
        }
        let o = &self.optimizer;
        for column in with_moments(layout) {
            let (m, v) = (o.first.values(column.attribute), o.second.values(column.attribute));
            arrays.add(&moments_name(column), For::Resuming, &[2, m.len()], &[m, v].concat());
        }
        for (name, m) in QUANTIZER_MOMENT_NAMES.into_iter().zip([&o.quantizer_steps, &o.quantizer_offsets]) {
            arrays.add(name, For::Resuming, &[2, m.first.len()], &[&m.first[..], &m.second].concat());
        }
        let mut steps: Vec<u64> = with_steps_alone(layout).map(|column| o.steps[column.attribute.index()]).collect();
        steps.push(o.mask.step);
        steps.extend(with_moments(layout).map(|column| o.steps[column.attribute.index()]));
        steps.extend([o.quantizer_steps.step, o.quantizer_offsets.step]);
        arrays.add(STEPS, For::Resuming, &[steps.len()], &steps);
        if !self.gate.errors.is_empty() {
            // The number of tiles may differ between views; the number of estimates does not.
            let g = &self.gate;
            let tiles: Vec<u64> = g.errors.iter().map(|errors| errors.len() as u64).collect();
            let (errors, noise) = (g.errors.concat(), g.noise.concat());
            arrays.add(GATE_TILES, For::Resuming, &[tiles.len()], &tiles);
            arrays.add("gate_errors", For::Resuming, &[errors.len()], &errors);
            arrays.add("gate_noise", For::Resuming, &[tiles.len(), noise.len() / tiles.len()], &noise);
            if !self.unseen.is_empty() {
                arrays.add(GATE_UNSEEN, For::Resuming, &[self.unseen.len()], &wide(&self.unseen));
            }
        }
        if first {
            let cameras = p.camera_gains.len();
            arrays.add("camera_gains", For::Scene, &[cameras, 3], p.camera_gains.as_flattened());
            arrays.add("camera_offsets", For::Scene, &[cameras, 3], p.camera_offsets.as_flattened());
        }
        if first || has_lifetimes {
            let foreground: Vec<u8> = p.foreground.iter().map(|&f| u8::from(f)).collect();
            arrays.add(FOREGROUND, For::Scene, &[n], &foreground);
        }
        if first {
            arrays.add("scene_radius", For::Scene, &[1], &[self.scene_radius]);
            if let Some(q) = &self.quantizers {
                let groups: Vec<u8> = q.groups.iter().flat_map(|&(a, width)| [a.index() as u8, width]).collect();
                arrays.add("quantizer_groups", For::Scene, &[q.groups.len(), 2], &groups);
                arrays.add("quantizer_initial_steps", For::Scene, &[q.initial_steps.len()], &q.initial_steps);
                arrays.add("bit_widths", For::Scene, &[layout.columns().len(), n], &q.bit_map.widths.concat());
            }
        }
        arrays.0
    }

    /// Reads an archive that [`Self::save`] wrote.
    ///
    /// - `first`: the checkpoint of timestep 0, which supplies everything that does not vary with time; `None` to read
    ///   timestep 0 itself
    /// - `learned_offset`: [`QuantizeConfig::learned_offset`](crate::QuantizeConfig::learned_offset) of the run
    ///
    /// # Errors
    /// [`TrainError::File`] if the file is not a complete checkpoint of this run.
    pub fn load(path: &Path, first: Option<&Self>, learned_offset: bool) -> Result<Self, TrainError> {
        let failed = |problem: String| TrainError::File { path: path.into(), problem };
        let npz = NpzReader::open(path);
        let mut npz = npz.map_err(|error| failed(format!("not a checkpoint: {}", problem_of(error))))?;
        let names: Vec<String> = npz.array_names().collect();
        let read = |name: String| Ok((name.clone(), Arc::new(Array::read(&mut npz, &name)?)));
        let arrays = names.into_iter().map(read).collect::<Result<Arrays, String>>().map_err(failed)?;
        get::<u64>(&arrays, STEPS).map_err(failed)?;
        Self::from_arrays(&arrays, first, learned_offset).map_err(failed)
    }

    /// The checkpoint in some arrays. Without the arrays for resuming, the optimizer's state is all zero.
    ///
    /// - `first`, `learned_offset`: see [`Self::load`]
    ///
    /// # Errors
    /// A message about the arrays.
    pub(crate) fn from_arrays(arrays: &Arrays, first: Option<&Self>, learned_offset: bool) -> Result<Self, String> {
        read(arrays, first, learned_offset)
    }

    /// The parameters among arrays.
    ///
    /// - `first`: see [`Self::load`]
    ///
    /// # Errors
    /// A message about the arrays.
    pub(crate) fn parameters_of(arrays: &Arrays, first: Option<&Self>) -> Result<Parameters, String> {
        read_parameters(arrays, first)
    }

    /// The mask logits among arrays.
    ///
    /// # Errors
    /// A message about the arrays.
    pub(crate) fn mask_logits_of(arrays: &Arrays) -> Result<&[f32], String> {
        get(arrays, MASK_LOGITS)
    }

    /// The lives among arrays; none if all Gaussians were there at first and have not died.
    ///
    /// # Errors
    /// A message about the arrays.
    pub(crate) fn lives_of(arrays: &Arrays) -> Result<Option<Lives>, String> {
        if has_lifetimes(arrays) { read_lives(arrays).map(Some) } else { Ok(None) }
    }

    /// Whether arrays include the optimizer's state, from which the next timestep starts.
    pub(crate) fn can_resume_from(arrays: &Arrays) -> bool {
        arrays.contains_key(STEPS)
    }
}

/// The reader of an array.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum For {
    /// A reader of the scene at this timestep. The run keeps the array for every timestep.
    Scene,
    /// The next timestep alone. The run keeps the array for the last two timesteps.
    Resuming,
}

/// Arrays as they are added.
#[derive(Default)]
struct List(Vec<(String, For, Array)>);

impl List {
    fn add<T: Value>(&mut self, name: &str, used_for: For, shape: &[usize], values: &[T]) {
        self.0.push((name.into(), used_for, Array::new(shape, values.to_vec())));
    }
}

/// Name of an array whose presence means that the Gaussians are drawn with antialiasing.
const ANTIALIASED: &str = "antialiased";
/// Name of the array of the background's colour, sRGB of 255; black without it.
const BACKGROUND: &str = "background";
/// Name of the array of all counts of updates; every state of an optimizer has it.
const STEPS: &str = "steps";
/// Name of the array of mask logits.
pub(crate) const MASK_LOGITS: &str = "mask_logits";
const GATE_TILES: &str = "gate_tiles";
const GATE_UNSEEN: &str = "gate_unseen";
const FOREGROUND: &str = "foreground";
/// Names of the arrays of [`Lives`].
pub(crate) const LIVES: [&str; 2] = ["births", "deaths"];
const LIFETIME_NAMES: [&str; 3] = ["ids", LIVES[0], LIVES[1]];
const BORN_MEANS: &str = "born_means";
const BORN_QUATS: &str = "born_quats";
const QUANTIZER_MOMENT_NAMES: [&str; 2] = ["quantizer_step_moments", "quantizer_offset_moments"];

/// The columns after the first five, one per line: a checkpoint's description of its layout.
fn table_of(layout: &Layout) -> String {
    let line = |c: &Column| {
        let Column { name, activation, varies, quantized, rate, unit, .. } = c;
        format!("{name}\t{}\t{activation:?}\t{varies}\t{quantized}\t{rate:?}\t{unit}\n", c.components())
    };
    layout.columns()[Attribute::BASE.len()..].iter().map(line).collect()
}

/// The layout that [`table_of`] describes; none if a line does not parse.
fn layout_of(table: &str) -> Option<Layout> {
    let named = |word: &str| -> Option<Activation> {
        Activation::ALL.into_iter().find(|activation| format!("{activation:?}") == word)
    };
    let rate =
        |word: &str| -> Option<RateGroup> { RateGroup::ALL.into_iter().find(|rate| format!("{rate:?}") == word) };
    let mut layout = Layout::default();
    for line in table.lines() {
        let words: Vec<&str> = line.split('\t').collect();
        let &[name, components, activation, varies, quantized, group, unit] = words.as_slice() else { return None };
        let components = components.parse().ok().filter(|c| (1..=255).contains(c))?;
        if layout.find(name).is_some() || layout.columns().len() > 255 {
            return None;
        }
        let column = Column {
            activation: named(activation)?,
            varies: varies.parse().ok()?,
            quantized: quantized.parse().ok()?,
            rate: rate(group)?,
            unit: unit.to_owned(),
            ..Column::like(Attribute::Color)
        };
        layout.push(name, components, column);
    }
    Some(layout)
}

/// - `n`: number of Gaussians
fn read_unseen(arrays: &Arrays, n: usize) -> Result<Vec<u32>, String> {
    let unseen = if arrays.contains_key(GATE_UNSEEN) { narrow(arrays, GATE_UNSEEN)? } else { Vec::new() };
    match unseen.len() {
        found if found == 0 || found == n => Ok(unseen),
        found => Err(format!("{GATE_UNSEEN} holds {found} values, expected {n}")),
    }
}

fn read_gate(arrays: &Arrays) -> Result<GateRecord, String> {
    let tiles = get::<u64>(arrays, GATE_TILES)?;
    let (errors, noise) = (get::<f32>(arrays, "gate_errors")?, get::<f32>(arrays, "gate_noise")?);
    let sum = tiles.iter().try_fold(0_u64, |sum, &count| sum.checked_add(count));
    if sum != Some(errors.len() as u64) || tiles.is_empty() || !noise.len().is_multiple_of(tiles.len()) {
        return Err("gate_tiles does not fit gate_errors and gate_noise".into());
    }
    let mut rest = errors;
    let mut take = |count: u64| {
        let (own, after) = rest.split_at(count as usize);
        rest = after;
        own.to_vec()
    };
    let per_camera = noise.len() / tiles.len();
    Ok(GateRecord {
        errors: tiles.iter().map(|&count| take(count)).collect(),
        noise: (0..tiles.len()).map(|i| noise[i * per_camera..][..per_camera].to_vec()).collect(),
    })
}

/// Reads everything that is drawn, and the cameras' gains and offsets.
fn read_parameters(arrays: &Arrays, first: Option<&Checkpoint>) -> Result<Parameters, String> {
    let means = get::<f32>(arrays, "means")?;
    // Without births and deaths the number of Gaussians is that of the first timestep.
    let n = match first {
        Some(first) if !has_lifetimes(arrays) => first.parameters.num_gaussians(),
        _ => means.len() / 3,
    };
    let layout = match first {
        Some(first) => Arc::clone(first.parameters.gaussians.layout()),
        None if arrays.contains_key("columns") => {
            let table = String::from_utf8(get::<u8>(arrays, "columns")?.to_vec()).ok();
            let layout = table.and_then(|table| layout_of(&table));
            Arc::new(layout.ok_or("columns is no table of columns")?)
        }
        None => Layout::base(),
    };
    let layout = if arrays.contains_key(ANTIALIASED) { layout.antialiased(true) } else { layout };
    let layout = match arrays.contains_key(BACKGROUND) {
        true => {
            let color = get::<u8>(arrays, BACKGROUND)?.first_chunk().copied();
            layout.with_background(color.ok_or("background is no colour")?)
        }
        false => layout,
    };
    let mut gaussians = Gaussians::zeros_of(&layout, n);
    for column in layout.columns() {
        let (name, values) = (values_name(column), gaussians.values_mut(column.attribute));
        match first {
            Some(first) if !column.varies && !has_lifetimes(arrays) => {
                values.copy_from_slice(first.parameters.gaussians.values(column.attribute))
            }
            _ => fill(&name, values, get::<f32>(arrays, &name)?)?,
        }
    }
    let mut mask_logits = vec![0.0; n];
    fill(MASK_LOGITS, &mut mask_logits, get::<f32>(arrays, MASK_LOGITS)?)?;
    let foreground: Vec<bool> = match first {
        Some(first) if !has_lifetimes(arrays) => first.parameters.foreground.clone(),
        _ => get::<u8>(arrays, FOREGROUND)?.iter().map(|&f| f != 0).collect(),
    };
    let (camera_gains, camera_offsets) = match first {
        Some(Checkpoint { parameters: p, .. }) => (p.camera_gains.clone(), p.camera_offsets.clone()),
        None => (
            get::<f32>(arrays, "camera_gains")?.as_chunks().0.to_vec(),
            get::<f32>(arrays, "camera_offsets")?.as_chunks().0.to_vec(),
        ),
    };
    if foreground.len() != n {
        return Err(format!("foreground holds {} values, expected {n}", foreground.len()));
    }
    Ok(Parameters { gaussians, mask_logits, foreground, camera_gains, camera_offsets })
}

fn read(arrays: &Arrays, first: Option<&Checkpoint>, learned_offset: bool) -> Result<Checkpoint, String> {
    let parameters = read_parameters(arrays, first)?;
    let (n, layout) = (parameters.num_gaussians(), parameters.gaussians.layout());
    let lifetimes = if has_lifetimes(arrays) { read_lifetimes(arrays, n)? } else { Lifetimes::new(n) };
    let num_first = lifetimes.lives.partition_point(|life| life.birth == 0);
    if let Some(first) = first.map(|first| first.parameters.num_gaussians()).filter(|&first| first != num_first) {
        return Err(format!("{} has {num_first} Gaussians of the first timestep, expected {first}", LIVES[0]));
    }
    let born = read_born(arrays, &lifetimes)?;
    let (scene_radius, bits) = match first {
        Some(first) => {
            let living: Vec<usize> = lifetimes.ids.iter().map(|&id| id as usize).collect();
            let bits = |q: &FakeQuantizers| {
                let bit_map = q.bit_map_of(lifetimes.lives.len()).select(&living);
                (bit_map, q.groups.clone(), q.initial_steps.clone())
            };
            (first.scene_radius, first.quantizers.as_ref().map(bits))
        }
        None => {
            let radius = get::<f32>(arrays, "scene_radius")?.first().copied().ok_or("scene_radius is empty")?;
            (radius, read_bits(arrays, layout, n)?)
        }
    };
    let quantizers = match bits {
        None => None,
        Some((bit_map, groups, initial_steps)) => {
            let (steps, offsets) = (get::<f32>(arrays, "quantizer_steps")?, get::<f32>(arrays, "quantizer_offsets")?);
            let widths: Vec<u8> = groups.iter().flat_map(|&(a, width)| vec![width; a.components()]).collect();
            if [steps.len(), offsets.len(), initial_steps.len()] != [widths.len(); 3] {
                return Err(format!("{} quantizer steps, expected {}", steps.len(), widths.len()));
            }
            let quantizers: Vec<Quantizer> = (steps.iter().zip(offsets).zip(&widths))
                .map(|((&step, &offset), &bits)| Quantizer { step, offset, bits })
                .collect();
            if let Some(problem) = quantizers.iter().find_map(Quantizer::problem) {
                return Err(format!("a quantizer is damaged: {problem}"));
            }
            let mut restored = FakeQuantizers::restore(bit_map, groups, quantizers, initial_steps, learned_offset);
            if let Some(first) = first.and_then(|first| first.quantizers.as_ref()) {
                restored.newborn_widths.clone_from(&first.newborn_widths);
            }
            Some(restored)
        }
    };
    let num_quantizers = quantizers.as_ref().map_or(0, |q| q.quantizers.len());
    let optimizer = match Checkpoint::can_resume_from(arrays) {
        true => read_optimizer(arrays, &parameters, num_quantizers)?,
        false => Optimizer::new(&parameters, num_quantizers),
    };
    let gate = if arrays.contains_key(GATE_TILES) { read_gate(arrays)? } else { GateRecord::default() };
    let unseen = read_unseen(arrays, n)?;
    Ok(Checkpoint { parameters, lifetimes, quantizers, optimizer, scene_radius, gate, unseen, born })
}

/// Whether arrays give lifetimes; without them all Gaussians live from the first timestep on.
fn has_lifetimes(arrays: &Arrays) -> bool {
    LIFETIME_NAMES.iter().any(|name| arrays.contains_key(*name))
}

fn read_born(arrays: &Arrays, lifetimes: &Lifetimes) -> Result<Pose, String> {
    let num_born = lifetimes.ids.len() - lifetimes.num_first();
    // Only a resuming run needs them.
    if num_born == 0 || !Checkpoint::can_resume_from(arrays) {
        return Ok(Pose::default());
    }
    let means = get::<f32>(arrays, BORN_MEANS)?.as_chunks().0.to_vec();
    let quats = get::<f32>(arrays, BORN_QUATS)?.as_chunks().0.to_vec();
    if [means.len(), quats.len()] != [num_born; 2] {
        let found = [means.len(), quats.len()];
        return Err(format!("{BORN_MEANS} and {BORN_QUATS} hold {found:?} poses, expected {num_born}"));
    }
    Ok(Pose { means, quats })
}

fn read_lifetimes(arrays: &Arrays, n: usize) -> Result<Lifetimes, String> {
    let (ids, lives) = (narrow(arrays, LIFETIME_NAMES[0])?, read_lives(arrays)?);
    let living = (0_u32..).zip(lives.iter()).filter(|(_, life)| life.death == Life::NEVER).map(|(id, _)| id);
    if !living.eq(ids.iter().copied()) {
        return Err("ids are not those that births and deaths leave".into());
    }
    if n == 0 || ids.len() != n {
        return Err(format!("{} Gaussians live, and there are values of {n}", ids.len()));
    }
    Ok(Lifetimes { ids, lives })
}

fn read_lives(arrays: &Arrays) -> Result<Lives, String> {
    let [births, deaths] = LIVES.map(|name| narrow(arrays, name));
    let (births, deaths) = (births?, deaths?);
    if !births.is_sorted() {
        return Err("births are not in their order".into());
    }
    if births.len() != deaths.len() || births.iter().zip(&deaths).any(|(birth, death)| birth >= death) {
        return Err("deaths do not fit births".into());
    }
    Ok(births.into_iter().zip(deaths).map(|(birth, death)| Life { birth, death }).collect())
}

fn narrow(arrays: &Arrays, name: &str) -> Result<Vec<u32>, String> {
    let values = get::<u64>(arrays, name)?.iter().map(|&value| u32::try_from(value).ok());
    values.collect::<Option<_>>().ok_or_else(|| format!("{name} is not below 2^32"))
}

fn wide(values: &[u32]) -> Vec<u64> {
    values.iter().map(|&value| value.into()).collect()
}

fn read_optimizer(arrays: &Arrays, parameters: &Parameters, num_quantizers: usize) -> Result<Optimizer, String> {
    let layout = parameters.gaussians.layout();
    let mut o = Optimizer::new(parameters, num_quantizers);
    for column in with_moments(layout) {
        let name = moments_name(column);
        let both = get::<f32>(arrays, &name)?;
        let (m, v) = both.split_at(both.len() / 2);
        fill(&name, o.first.values_mut(column.attribute), m)?;
        fill(&name, o.second.values_mut(column.attribute), v)?;
    }
    for (name, moments) in QUANTIZER_MOMENT_NAMES.into_iter().zip([&mut o.quantizer_steps, &mut o.quantizer_offsets]) {
        let both = get::<f32>(arrays, name)?;
        let (m, v) = both.split_at(both.len() / 2);
        fill(name, &mut moments.first, m)?;
        fill(name, &mut moments.second, v)?;
    }
    let steps = get::<u64>(arrays, STEPS)?;
    let (alone, with): (Vec<_>, Vec<_>) = (with_steps_alone(layout).collect(), with_moments(layout).collect());
    let expected = alone.len() + 1 + with.len() + 2;
    if steps.len() != expected {
        return Err(format!("steps holds {} values, expected {expected}", steps.len()));
    }
    let mut steps = steps.iter().copied();
    let mut next = || steps.next().expect("counted above");
    for column in alone {
        o.steps[column.attribute.index()] = next();
    }
    o.mask.step = next();
    for column in with {
        o.steps[column.attribute.index()] = next();
    }
    (o.quantizer_steps.step, o.quantizer_offsets.step) = (next(), next());
    Ok(o)
}

type Bits = (BitMap, Vec<(Attribute, u8)>, Vec<f32>);

fn read_bits(arrays: &Arrays, layout: &Arc<Layout>, n: usize) -> Result<Option<Bits>, String> {
    // All of them or none: an archive's list of names has no checksum.
    if !["quantizer_groups", "quantizer_initial_steps", "quantizer_steps", "bit_widths"]
        .iter()
        .any(|a| arrays.contains_key(*a))
    {
        return Ok(None);
    }
    let widths = get::<u8>(arrays, "bit_widths")?;
    let expected = layout.columns().len() * n;
    if widths.len() != expected || widths.iter().any(|w| !(1..=16).contains(w)) {
        return Err(format!("bit_widths holds {} values, expected {expected} of 1 to 16", widths.len()));
    }
    let groups: Vec<(Attribute, u8)> = get::<u8>(arrays, "quantizer_groups")?
        .chunks_exact(2)
        .map(|g| {
            layout.columns().get(usize::from(g[0])).filter(|_| (1..=16).contains(&g[1])).map(|c| (c.attribute, g[1]))
        })
        .collect::<Option<_>>()
        .ok_or("quantizer_groups names an attribute or a width that does not exist")?;
    let widths = (0..layout.columns().len()).map(|a| widths[a * n..(a + 1) * n].to_vec()).collect();
    Ok(Some((BitMap::new(Arc::clone(layout), widths), groups, get(arrays, "quantizer_initial_steps")?.to_vec())))
}

fn fill(name: &str, into: &mut [f32], values: &[f32]) -> Result<(), String> {
    if into.len() != values.len() {
        return Err(format!("{name} holds {} values, expected {}", values.len(), into.len()));
    }
    into.copy_from_slice(values);
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_birth_needs_a_later_death() {
        let read = |births: &[u64], deaths: &[u64]| {
            let array = |values: &[u64]| Arc::new(Array::new(&[values.len()], values.to_vec()));
            let arrays = LIVES.map(String::from).into_iter().zip([births, deaths].map(array)).collect();
            read_lives(&arrays)
        };
        assert_eq!(read(&[0, 2], &[1, Life::NEVER.into()]).unwrap()[..], [Life { birth: 0, death: 1 }, Life::since(2)]);
        for deaths in [&[1][..], &[1, 2], &[1, 3, 4]] {
            assert_eq!(read(&[0, 2], deaths).unwrap_err(), "deaths do not fit births", "{deaths:?}");
        }
    }
}
