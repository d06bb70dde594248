//! Compares a `.tcgs` file with the compressed scene: its errors must be within the declared ones. What does not live
//! here: the definition of an error (`tcgs_codec::attribute_error`).

mod matching;
mod tree;

use tcgs_codec::{AttributeErrors, DecodeLimits};
use tcgs_core::SceneReader;

use self::matching::{Bounds, Pairs};
use crate::observe::tell;
use crate::{Event, Observer, OpenScene, PipelineError, Work};

/// Bytes of memory per byte of a long file, to decode all of it. Scenes of few timesteps with harmonics need twenty.
const MAX_EXPANSION_OF_LONG: u64 = 32;

/// The limits for decoding a whole file at once, for `tcgs verify` and before a compressed scene is returned. A player
/// decodes one segment at a time, within lower limits.
///
/// - `file_bytes`: length of the file
pub fn whole_file_limits(file_bytes: u64) -> DecodeLimits {
    let limits = DecodeLimits::default();
    let max_bytes = limits.max_bytes.max(file_bytes.saturating_mul(MAX_EXPANSION_OF_LONG));
    DecodeLimits { max_bytes, ..limits }
}

/// The result of a comparison.
#[derive(Clone, Debug, PartialEq)]
pub struct Comparison {
    /// In the order of the layout.
    pub attributes: Vec<Compared>,
    /// Number of compared timesteps: all.
    pub num_timesteps: usize,
    /// Number of Gaussians of the file, summed over all timesteps.
    pub num_compared: u64,
    /// Number of these without a Gaussian of the source within the declared errors.
    pub num_beyond: u64,
    /// Fewest and most Gaussians of the source at a timestep without a partner in the file: they were pruned.
    pub num_pruned: [usize; 2],
}

/// An attribute in a comparison.
#[derive(Clone, Debug, PartialEq)]
pub struct Compared {
    /// Its name.
    pub name: String,
    /// Its largest error as the file declares it; none if it does not.
    pub declared: Option<f32>,
    /// The largest error found, in the unit of [`tcgs_codec::attribute_error`].
    pub found: f64,
}

impl Compared {
    /// Whether an error is declared and no error found is larger.
    pub fn holds(&self) -> bool {
        self.declared.is_some_and(|declared| self.found <= f64::from(declared))
    }
}

impl Comparison {
    /// Whether the file declares an error for every attribute and every Gaussian of it has one of the source within
    /// these.
    pub fn holds(&self) -> bool {
        self.num_beyond == 0 && self.attributes.iter().all(Compared::holds)
    }
}

/// Compares a file with its source, timestep by timestep. Each Gaussian of the file is paired with one of the source,
/// no two with the same. The partner is within the declared errors of all attributes if possible; otherwise it is the
/// nearest one left. Every timestep is reported as [`Event::Frame`].
///
/// ```
/// use tcgs_core::{DynamicGaussians, Gaussians};
/// use tcgs_interchange::{ParamsExtras, write_params_npz};
/// use tcgs_pipeline::{CompressOptions, OpenScene, OpenSettings, Unobserved, compare, compress_scene};
///
/// let folder = tempfile::tempdir()?;
/// let path = folder.path().join("params.npz");
/// let mut floats = DynamicGaussians::default();
/// floats.push(Gaussians::zeros(5));
/// write_params_npz(&path, &floats, &ParamsExtras::default())?;
///
/// let source = OpenScene::open(&path, OpenSettings::default())?;
/// let compressed = compress_scene(&source, &CompressOptions::default())?;
/// let file = source.with_symbols(compressed.compact);
/// assert!(compare(&file, &source, &mut Unobserved)?.holds());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`PipelineError::Input`] if the source has other attributes or another number of timesteps than the file;
/// [`PipelineError`] if a timestep cannot be read; [`PipelineError::Stopped`] if the observer broke off.
pub fn compare(file: &OpenScene, source: &OpenScene, observer: &mut dyn Observer) -> Result<Comparison, PipelineError> {
    let (layout, num_timesteps) = (SceneReader::layout(file).clone(), file.num_timesteps());
    let expected_as = |what: String| format!("{what} as {}", file.path.display());
    // The layout of a file without Gaussians carries no information, and a background is no attribute.
    if SceneReader::layout(source).with_background(layout.background()) != layout && file.num_identities() != Some(0) {
        let found = format!("has the columns {}", SceneReader::layout(source));
        return Err(PipelineError::input(source.path.display(), found, expected_as(layout.to_string())));
    }
    if source.num_timesteps() != num_timesteps {
        let found = format!("has {} timesteps", source.num_timesteps());
        return Err(PipelineError::input(source.path.display(), found, expected_as(num_timesteps.to_string())));
    }
    tell(observer, Event::Begun { work: Work::Verifying, num_steps: num_timesteps })?;
    let declared = file.declared_errors();
    let bounds = Bounds::new(layout.columns(), &declared);
    let (mut errors, mut before) = (AttributeErrors::none(&layout), Pairs::default());
    let mut comparison = Comparison {
        attributes: Vec::new(),
        num_timesteps,
        num_compared: 0,
        num_beyond: 0,
        num_pruned: [usize::MAX, 0],
    };
    for timestep in 0..num_timesteps {
        let (original, decoded) = (source.at(timestep)?.with_background(layout.background()), file.at(timestep)?);
        let num_decoded = decoded.num_gaussians();
        if num_decoded > 0 {
            let pairs = bounds.pairs(&original, &decoded, &before);
            let rows = pairs.partners.iter().enumerate();
            errors.add_rows(&original, &decoded, rows.filter_map(|(row, of)| of.map(|of| (of as usize, row))));
            comparison.num_beyond += pairs.num_beyond as u64;
            before = pairs;
        }
        let pruned = original.num_gaussians().saturating_sub(num_decoded);
        comparison.num_compared += num_decoded as u64;
        comparison.num_pruned = [comparison.num_pruned[0].min(pruned), comparison.num_pruned[1].max(pruned)];
        tell(observer, Event::Frame(file.first_frame + timestep))?;
    }
    let declared = |name: &str| declared.iter().find(|(of, _)| of == name).map(|(_, error)| *error);
    let compared = |(name, found): (&str, f64)| Compared { name: name.to_owned(), declared: declared(name), found };
    comparison.attributes = errors.by_name().into_iter().map(compared).collect();
    Ok(comparison)
}
