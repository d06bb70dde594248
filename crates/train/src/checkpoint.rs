//! Checkpoints: the result of one timestep, and the optimiser's state that the next timestep starts from. Each timestep
//! has one npz archive, which is written atomically.

use std::io::{BufWriter, Seek, Write};
use std::path::Path;
use std::sync::Arc;

use tcgs_codec::{BitMap, Quantizer};
use tcgs_core::{Activation, Attribute, Column, Gaussians, Layout, RateGroup};
use tcgs_interchange::{Existing, InterchangeError, NpyValue, NpzReader, NpzWriter, write_whole};

use crate::TrainError;
use crate::fake_quant::FakeQuantizers;
use crate::lifetimes::Lifetimes;
use crate::parameters::Parameters;
use crate::state::{Optimizer, goes_on};

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
}

/// Name of the array with the moments of a column.
fn moments_name(column: &Column) -> String {
    // Files had it before a layout could have further columns.
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

/// The columns that vary and of whose Adam nothing but the number of updates goes on.
fn with_steps_alone(layout: &Layout) -> impl Iterator<Item = &Column> {
    layout.columns().iter().filter(|column| column.varies && !goes_on(column))
}

impl Checkpoint {
    /// Writes the archive atomically. Equal checkpoints give equal bytes.
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
        let p = &self.parameters;
        let n = p.num_gaussians();
        let layout = p.gaussians.layout();
        if first && !layout.is_base() {
            let table = table_of(layout);
            npz.array("columns", &[table.len()], [table.as_bytes()])?;
        }
        for column in layout.columns().iter().filter(|column| first || column.varies) {
            let shape = [n, column.components()];
            let shape = if column.components() == 1 { &shape[..1] } else { &shape };
            npz.array(&values_name(column), shape, [p.gaussians.values(column.attribute)])?;
        }
        if !self.lifetimes.are_whole() {
            let l = &self.lifetimes;
            for (name, values) in LIFETIME_NAMES.into_iter().zip([&l.ids, &l.births, &l.deaths]) {
                let wide: Vec<u64> = values.iter().map(|&value| value.into()).collect();
                npz.array(name, &[n], [&wide[..]])?;
            }
        }
        npz.array("mask_logits", &[n], [p.mask_logits.as_slice()])?;
        let flat = |q: &FakeQuantizers, f: fn(&Quantizer) -> f32| q.quantizers.iter().map(f).collect::<Vec<_>>();
        if let Some(q) = &self.quantizers {
            npz.array("quantizer_steps", &[q.quantizers.len()], [&flat(q, |q| q.step)[..]])?;
            npz.array("quantizer_offsets", &[q.quantizers.len()], [&flat(q, |q| q.offset)[..]])?;
        }
        let o = &self.optimizer;
        for column in with_moments(layout) {
            let (m, v) = (o.first.values(column.attribute), o.second.values(column.attribute));
            npz.array(&moments_name(column), &[2, m.len()], [m, v])?;
        }
        for (name, m) in QUANTIZER_MOMENT_NAMES.into_iter().zip([&o.quantizer_steps, &o.quantizer_offsets]) {
            npz.array(name, &[2, m.first.len()], [m.first.as_slice(), &m.second])?;
        }
        let mut steps: Vec<u64> = with_steps_alone(layout).map(|column| o.steps[column.attribute.index()]).collect();
        steps.push(o.mask.step);
        steps.extend(with_moments(layout).map(|column| o.steps[column.attribute.index()]));
        steps.extend([o.quantizer_steps.step, o.quantizer_offsets.step]);
        npz.array("steps", &[steps.len()], [&steps[..]])?;
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
                npz.array("bit_widths", &[layout.columns().len(), n], q.bit_map.widths.iter().map(Vec::as_slice))?;
            }
        }
        // Left to be dropped, the archive would swallow a full disk.
        npz.finish()?.flush()
    }

    /// Reads the archive of one timestep.
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
        read(&mut npz, first, learned_offset).map_err(failed)
    }
}

const LIFETIME_NAMES: [&str; 3] = ["ids", "births", "deaths"];
const QUANTIZER_MOMENT_NAMES: [&str; 2] = ["quantizer_step_moments", "quantizer_offset_moments"];

/// The columns after the first five, a line each: how a checkpoint says its layout.
fn table_of(layout: &Layout) -> String {
    let line = |c: &Column| {
        let Column { name, activation, varies, quantized, rate, unit, .. } = c;
        format!("{name}\t{}\t{activation:?}\t{varies}\t{quantized}\t{rate:?}\t{unit}\n", c.components())
    };
    layout.columns()[Attribute::BASE.len()..].iter().map(line).collect()
}

/// The layout that [`table_of`] says; none if a line is not one of its.
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

fn read(npz: &mut NpzReader, first: Option<&Checkpoint>, learned_offset: bool) -> Result<Checkpoint, String> {
    let means = get::<f32>(npz, "means")?;
    let n = first.map_or(means.len() / 3, |f| f.parameters.num_gaussians());
    let layout = match first {
        Some(first) => Arc::clone(first.parameters.gaussians.layout()),
        None if npz.contains("columns") => {
            let table = String::from_utf8(get::<u8>(npz, "columns")?).ok();
            let layout = table.and_then(|table| layout_of(&table));
            Arc::new(layout.ok_or("columns is no table of columns")?)
        }
        None => Layout::base(),
    };
    let mut gaussians = Gaussians::zeros_of(&layout, n);
    for column in layout.columns() {
        let (name, values) = (values_name(column), gaussians.values_mut(column.attribute));
        match first {
            Some(first) if !column.varies => {
                values.copy_from_slice(first.parameters.gaussians.values(column.attribute))
            }
            _ => fill(&name, values, &get::<f32>(npz, &name)?)?,
        }
    }
    let lifetimes =
        if LIFETIME_NAMES.iter().any(|name| npz.contains(name)) { read_lifetimes(npz, n)? } else { Lifetimes::new(n) };
    let mut mask_logits = vec![0.0; n];
    fill("mask_logits", &mut mask_logits, &get::<f32>(npz, "mask_logits")?)?;
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
            (radius, read_bits(npz, &layout, n)?)
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
    let optimizer = read_optimizer(npz, &parameters, quantizers.as_ref().map_or(0, |q| q.quantizers.len()))?;
    Ok(Checkpoint { parameters, lifetimes, quantizers, optimizer, scene_radius })
}

fn read_lifetimes(npz: &mut NpzReader, n: usize) -> Result<Lifetimes, String> {
    let mut column = |name: &str| -> Result<Vec<u32>, String> {
        let values = get::<u64>(npz, name)?;
        let narrow: Option<Vec<u32>> = values.iter().map(|&value| u32::try_from(value).ok()).collect();
        narrow.filter(|values| values.len() == n).ok_or_else(|| format!("{name} is not {n} values below 2^32"))
    };
    let [ids, births, deaths] = LIFETIME_NAMES;
    Ok(Lifetimes::from_columns(column(ids)?, column(births)?, column(deaths)?))
}

fn read_optimizer(npz: &mut NpzReader, parameters: &Parameters, num_quantizers: usize) -> Result<Optimizer, String> {
    let layout = parameters.gaussians.layout();
    let mut o = Optimizer::new(parameters, num_quantizers);
    for column in with_moments(layout) {
        let name = moments_name(column);
        let both = get::<f32>(npz, &name)?;
        let (m, v) = both.split_at(both.len() / 2);
        fill(&name, o.first.values_mut(column.attribute), m)?;
        fill(&name, o.second.values_mut(column.attribute), v)?;
    }
    for (name, moments) in QUANTIZER_MOMENT_NAMES.into_iter().zip([&mut o.quantizer_steps, &mut o.quantizer_offsets]) {
        let both = get::<f32>(npz, name)?;
        let (m, v) = both.split_at(both.len() / 2);
        fill(name, &mut moments.first, m)?;
        fill(name, &mut moments.second, v)?;
    }
    let steps = get::<u64>(npz, "steps")?;
    let (alone, with): (Vec<_>, Vec<_>) = (with_steps_alone(layout).collect(), with_moments(layout).collect());
    let expected = alone.len() + 1 + with.len() + 2;
    if steps.len() != expected {
        return Err(format!("steps holds {} values, expected {expected}", steps.len()));
    }
    let mut steps = steps.into_iter();
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

fn read_bits(npz: &mut NpzReader, layout: &Arc<Layout>, n: usize) -> Result<Option<Bits>, String> {
    // All of them or none: an archive's list of names has no checksum.
    if !["quantizer_groups", "quantizer_initial_steps", "quantizer_steps", "bit_widths"].iter().any(|a| npz.contains(a))
    {
        return Ok(None);
    }
    let widths = get::<u8>(npz, "bit_widths")?;
    let expected = layout.columns().len() * n;
    if widths.len() != expected || widths.iter().any(|w| !(1..=16).contains(w)) {
        return Err(format!("bit_widths holds {} values, expected {expected} of 1 to 16", widths.len()));
    }
    let groups: Vec<(Attribute, u8)> = get::<u8>(npz, "quantizer_groups")?
        .chunks_exact(2)
        .map(|g| {
            layout.columns().get(usize::from(g[0])).filter(|_| (1..=16).contains(&g[1])).map(|c| (c.attribute, g[1]))
        })
        .collect::<Option<_>>()
        .ok_or("quantizer_groups names an attribute or a width that does not exist")?;
    let widths = (0..layout.columns().len()).map(|a| widths[a * n..(a + 1) * n].to_vec()).collect();
    Ok(Some((BitMap::new(Arc::clone(layout), widths), groups, get(npz, "quantizer_initial_steps")?)))
}

fn get<T: NpyValue>(npz: &mut NpzReader, name: &str) -> Result<Vec<T>, String> {
    Ok(npz.array_of(name).map_err(problem_of)?.values)
}

/// What is wrong with a checkpoint, without its path.
fn problem_of(error: InterchangeError) -> String {
    match error {
        InterchangeError::Read { error, .. } | InterchangeError::Write { error, .. } => error.to_string(),
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
