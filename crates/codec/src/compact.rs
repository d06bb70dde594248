//! The compact scene: keypoints as codes, and the floats that the codes stand for.
//!
//! [`CompactScene::check`] holds the rules that every compact scene obeys, whether it comes from
//! [`compress`](crate::compress()) or from a file. Entropy coding and the layout of a file are the subject of
//! `bitstream`, the conversion from floats to codes that of `compress`.

use std::sync::Arc;

use tcgs_core::{Attribute, DynamicGaussians, Gaussians, Layout, Life, Lives, normalize};

use crate::bits::BitMap;
use crate::error::CompressError;
use crate::keypoints::sample;
use crate::parallel;
use crate::quantize::{MAX_BITS, Quantizer, Quantizers};

/// Largest number of timesteps of a [`CompactScene`]: a keypoint's time has 16 bits.
pub(crate) const MAX_TIMESTEPS: u32 = 1 << 16;

/// Counts and provenance of a scene: the fields of the section `INFO` (`docs/FORMAT.md`) that describe the scene.
///
/// ```
/// use tcgs_codec::{SceneInfo, UpAxis};
/// use tcgs_core::{DynamicGaussians, Gaussians};
/// let mut scene = DynamicGaussians::default();
/// scene.push(Gaussians::zeros(3));
/// let info = SceneInfo { name: "basketball".into(), up: UpAxis::MinusY, ..SceneInfo::of(&scene) };
/// assert_eq!((info.num_gaussians, info.num_timesteps, info.frame_rate), (3, 1, 30.0));
/// ```
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SceneInfo {
    /// `N`, the number of Gaussians that live at some timestep.
    pub num_gaussians: u32,
    /// `T`, the number of timesteps, at least 1; at most 65536 in a file of version 1 and in a [`CompactScene`].
    pub num_timesteps: u32,
    /// Frame number of the capture at timestep 0.
    pub first_frame: u32,
    /// Timesteps per second, finite; 0 if unknown.
    pub frame_rate: f32,
    /// Factor by which the capture's images were shrunk for training, at least 1.
    pub downscale: u32,
    /// Name of the capture: any text, at most 65535 bytes.
    pub name: String,
    /// Name and version of the program that made the scene: any text, at most 65535 bytes.
    pub generator: String,
    /// Colour space of [`Attribute::Color`].
    pub color_space: ColorSpace,
    /// World axis that points up.
    pub up: UpAxis,
}

/// Colour space of a scene's colours. Colours are blended as stored in either.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u8)]
#[non_exhaustive]
pub enum ColorSpace {
    /// Display-referred sRGB.
    #[default]
    Srgb = 0,
    /// Linear light with the primaries of sRGB.
    LinearSrgb = 1,
}

impl ColorSpace {
    /// All colour spaces, in the order of their numbers in a file.
    pub(crate) const ALL: [Self; 2] = [Self::Srgb, Self::LinearSrgb];
}

/// World axis that points up. The coordinate system is right-handed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u8)]
#[allow(missing_docs)]
pub enum UpAxis {
    #[default]
    Unknown = 0,
    PlusX = 1,
    PlusY = 2,
    PlusZ = 3,
    MinusX = 4,
    MinusY = 5,
    MinusZ = 6,
}

impl UpAxis {
    /// All axes, in the order of their numbers in a file.
    pub(crate) const ALL: [Self; 7] =
        [Self::Unknown, Self::PlusX, Self::PlusY, Self::PlusZ, Self::MinusX, Self::MinusY, Self::MinusZ];

    /// Sign and letter of the axis, such as `y` or `-y`; `unknown` for [`Self::Unknown`].
    pub fn name(self) -> &'static str {
        ["unknown", "x", "y", "z", "-x", "-y", "-z"][self as usize]
    }

    /// Unit vector along the axis, in world space. [`Self::Unknown`] gives that of [`Self::MinusY`], the convention of
    /// captures.
    ///
    /// ```
    /// use tcgs_codec::UpAxis;
    /// assert_eq!(UpAxis::PlusZ.direction(), [0.0, 0.0, 1.0]);
    /// assert_eq!(UpAxis::Unknown.direction(), UpAxis::MinusY.direction());
    /// ```
    pub fn direction(self) -> [f64; 3] {
        match self {
            Self::Unknown | Self::MinusY => [0.0, -1.0, 0.0],
            Self::PlusX => [1.0, 0.0, 0.0],
            Self::PlusY => [0.0, 1.0, 0.0],
            Self::PlusZ => [0.0, 0.0, 1.0],
            Self::MinusX => [-1.0, 0.0, 0.0],
            Self::MinusZ => [0.0, 0.0, -1.0],
        }
    }
}

impl SceneInfo {
    /// Counts of `scene` with defaults for all else: first frame 0, 30 frames per second, downscale 1, an empty name,
    /// this crate as generator, sRGB, unknown up axis.
    pub fn of(scene: &DynamicGaussians) -> Self {
        Self {
            num_gaussians: scene.num_gaussians() as u32,
            num_timesteps: scene.num_timesteps() as u32,
            first_frame: 0,
            frame_rate: 30.0,
            downscale: 1,
            name: String::new(),
            generator: concat!("tcgs ", env!("CARGO_PKG_VERSION")).to_owned(),
            color_space: ColorSpace::default(),
            up: UpAxis::default(),
        }
    }

    /// Checks the legal range of every field, as `docs/FORMAT.md` lists them under `INFO`.
    ///
    /// - `version`: of the format
    pub(crate) fn check(&self, version: u16) -> Result<(), Violation> {
        let SceneInfo { num_timesteps, frame_rate, downscale, ref name, ref generator, .. } = *self;
        let violation = |field, problem| Err(Violation { attribute: None, field, problem });
        if num_timesteps == 0 || version == 1 && num_timesteps > MAX_TIMESTEPS {
            violation("num_timesteps", if version == 1 { "not within 1 to 65536" } else { "zero" })
        } else if !(frame_rate.is_finite() && frame_rate >= 0.0) {
            violation("frame_rate", "negative or not finite")
        } else if downscale == 0 {
            violation("downscale", "zero")
        } else if name.len() > usize::from(u16::MAX) {
            violation("name", "longer than 65535 bytes")
        } else if generator.len() > usize::from(u16::MAX) {
            violation("generator", "longer than 65535 bytes")
        } else {
            Ok(())
        }
    }
}

/// Keypoints of many tracks in one pair of arrays, one track after another.
///
/// The track of component `channel` of Gaussian `gaussian` has the index `gaussian * components + channel`. A track of
/// one keypoint is constant over time.
///
/// ```
/// let mut tracks = tcgs_codec::Tracks::default();
/// tracks.push(&[0, 4, 9], &[-3_i16, 5, 5]);
/// tracks.push(&[0], &[7]); // constant
/// assert_eq!((tracks.len(), tracks.num_keypoints()), (2, 4));
/// assert_eq!(tracks.track(1), (&[0][..], &[7][..]));
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Tracks<V> {
    /// `[tracks + 1]`; keypoints of track `i` are `starts[i]..starts[i + 1]`.
    starts: Vec<usize>,
    /// `[keypoints]` timesteps.
    times: Vec<u16>,
    /// `[keypoints]`
    values: Vec<V>,
}

impl<V> Default for Tracks<V> {
    fn default() -> Self {
        Self { starts: vec![0], times: Vec::new(), values: Vec::new() }
    }
}

impl<V: Copy> Tracks<V> {
    /// Number of tracks.
    pub fn len(&self) -> usize {
        self.starts.len() - 1
    }

    /// Whether the number of tracks is 0.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Number of keypoints of all tracks together.
    pub fn num_keypoints(&self) -> usize {
        self.times.len()
    }

    /// Keypoints of one track: `[keypoints]` timesteps and `[keypoints]` values.
    ///
    /// # Panics
    /// If `index` is not below [`Self::len`].
    #[inline(always)]
    pub fn track(&self, index: usize) -> (&[u16], &[V]) {
        let range = self.starts[index]..self.starts[index + 1];
        (&self.times[range.clone()], &self.values[range])
    }

    /// All tracks, one after another, with mutable values.
    ///
    /// - returns: `[tracks + 1]`, keypoints of track `i` are `starts[i]..starts[i + 1]`; `[keypoints]` timesteps;
    ///   `[keypoints]` values
    pub fn parts_mut(&mut self) -> (&[usize], &[u16], &mut [V]) {
        (&self.starts, &self.times, &mut self.values)
    }

    /// Appends a track.
    ///
    /// - `times`: `[keypoints]` timesteps, strictly increasing from 0; [`encode`](crate::encode()) checks them
    /// - `values`: `[keypoints]`
    ///
    /// # Panics
    /// If `times` and `values` differ in length.
    pub fn push(&mut self, times: &[u16], values: &[V]) {
        assert_eq!(times.len(), values.len(), "{} times against {} values", times.len(), values.len());
        self.times.extend_from_slice(times);
        self.values.extend_from_slice(values);
        self.starts.push(self.times.len());
    }

    /// Appends all tracks of `other`.
    pub(crate) fn append(&mut self, other: &Self) {
        let base = self.times.len();
        self.times.extend_from_slice(&other.times);
        self.values.extend_from_slice(&other.values);
        self.starts.extend(other.starts[1..].iter().map(|s| base + s));
    }
}

/// A compressed scene before entropy coding, or one cohort of it. It holds the keypoints of every track as codes, the
/// bit widths and quantizers that convert codes to floats, and the division into layers and segments.
///
/// [`compress`](crate::compress()) makes it from floats, [`decode`](crate::decode()) from a file;
/// [`encode`](crate::encode()) writes it. A file of version 2 holds any number of them
/// ([`encode_cohorts`](crate::encode_cohorts()), [`decode_cohorts`](crate::decode_cohorts())). A program may also fill
/// the fields itself: encoding refuses a scene that breaks a rule, the other methods may panic on one.
#[derive(Clone, Debug, PartialEq)]
pub struct CompactScene {
    /// Columns of the Gaussians. Version 1 of the format holds the columns of [`Attribute::BASE`] only.
    pub layout: Arc<Layout>,
    /// Counts of these Gaussians and their timesteps, and provenance.
    pub info: SceneInfo,
    /// Timestep of the whole scene at which timestep 0 of this one lies; 0 in a file of version 1.
    pub start: u32,
    /// `[N]` lives, within the timesteps of this scene; `None` if all Gaussians live at all of them, as in a file of
    /// version 1.
    pub lives: Option<Lives>,
    /// Width of the codes of every attribute of every Gaussian, in bits. Width 0 marks a column beyond
    /// [`Attribute::BASE`] that the Gaussian lacks: its values are 0.
    pub bit_map: BitMap,
    /// Quantizers: one per component for every attribute and width in use.
    pub quantizers: Quantizers,
    /// By [`Attribute::index`]: whether tracks of the attribute may have more than one keypoint.
    pub varies: Vec<bool>,
    /// Number of Gaussians of each layer, the most important layer first; the first layers alone are a coarser scene.
    /// The layers divide the Gaussians in their order: at most 65535 layers, none empty, with the sum `N`.
    pub layers: Vec<u32>,
    /// Number of timesteps of a segment, 1 to 65536; the last segment may be shorter. Each segment decodes
    /// independently of the others.
    pub segment_length: u32,
    /// By [`Attribute::index`]: `[N * components]` tracks of codes.
    pub tracks: Vec<Tracks<i16>>,
}

/// How a scene breaks the rules of [`CompactScene::check`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Violation {
    /// Attribute whose codes, widths or quantizers break the rule; `None` for a rule of the whole scene.
    pub(crate) attribute: Option<Attribute>,
    pub(crate) field: &'static str,
    pub(crate) problem: &'static str,
}

impl CompactScene {
    /// `N`, the number of Gaussians.
    pub fn num_gaussians(&self) -> usize {
        self.info.num_gaussians as usize
    }

    /// `T`, the number of timesteps.
    pub fn num_timesteps(&self) -> usize {
        self.info.num_timesteps as usize
    }

    /// All timesteps as floats, in stored form: codes are dequantised, tracks are interpolated linearly between
    /// keypoints, and quaternions are normalised afterwards (`docs/FORMAT.md`, "Reconstruction").
    ///
    /// - returns: `T` timesteps; scales and opacities are held once if they do not vary
    pub fn reconstruct(&self) -> DynamicGaussians {
        let over_time = |attribute| (0..self.num_timesteps()).map(move |t| self.values_at(attribute, t));
        // Scales and opacities that do not vary are stored once.
        let once = |attribute: Attribute| {
            let varies = self.varies[attribute.index()] || self.layout.column(attribute).varies;
            if varies { self.num_timesteps() } else { 1 }
        };
        let samples = self.layout.attributes().map(|attribute| over_time(attribute).take(once(attribute)).collect());
        DynamicGaussians::from_samples(Arc::clone(&self.layout), self.num_timesteps(), samples.collect())
    }

    /// One timestep as floats, in stored form: the same values as [`Self::reconstruct`] gives at the timestep. A
    /// Gaussian that does not live at the timestep has the values of its first or last timestep.
    ///
    /// # Panics
    /// If `timestep` is not below [`Self::num_timesteps`].
    pub fn at(&self, timestep: usize) -> Gaussians {
        assert!(timestep < self.num_timesteps(), "timestep {timestep} of {}", self.num_timesteps());
        let values = self.layout.attributes().map(|attribute| self.values_at(attribute, timestep)).collect();
        Gaussians::new(Arc::clone(&self.layout), self.num_gaussians(), values)
    }

    /// Whether a Gaussian lives at a timestep of this scene.
    pub fn is_alive(&self, gaussian: usize, timestep: usize) -> bool {
        self.lives.as_ref().is_none_or(|lives| lives[gaussian].contains(timestep))
    }

    /// The Gaussians that live at a timestep of the whole scene, with the values of [`Self::at`]; `None` if the cohort
    /// does not span the timestep.
    pub fn alive_at(&self, timestep: usize) -> Option<Gaussians> {
        let now = self.own_timestep(timestep)?;
        let all = self.at(now);
        Some(self.lives.as_ref().map_or(all.clone(), |lives| all.select(&lives.living(now))))
    }

    /// Number of Gaussians that live at a timestep of the whole scene.
    pub(crate) fn num_alive_at(&self, timestep: usize) -> usize {
        let all = self.num_gaussians();
        self.own_timestep(timestep).map_or(0, |now| self.lives.as_ref().map_or(all, |lives| lives.num_living(now)))
    }

    /// A timestep of the whole scene, counted from [`Self::start`]; `None` if the cohort does not span it.
    fn own_timestep(&self, timestep: usize) -> Option<usize> {
        timestep.checked_sub(self.start as usize).filter(|&now| now < self.num_timesteps())
    }

    /// `[N * components]` values of one attribute at one timestep.
    fn values_at(&self, attribute: Attribute, timestep: usize) -> Vec<f32> {
        let components = attribute.components();
        let quantizers = self.quantizers.by_width(attribute);
        let widths = &self.bit_map.widths[attribute.index()];
        let tracks = &self.tracks[attribute.index()];
        let mut values = vec![0.0; widths.len() * components];
        parallel::for_each_row(&mut values, components, |gaussian, row| {
            let quantizers = quantizers[usize::from(widths[gaussian])];
            for (channel, value) in row.iter_mut().enumerate() {
                let (times, codes) = tracks.track(gaussian * components + channel);
                let quantizer = quantizers.get(channel);
                let value_of = |quantizer: &Quantizer, keypoint: usize| quantizer.dequantize(codes[keypoint].into());
                *value = quantizer.map_or(0.0, |q| sample(times, timestep, |keypoint| value_of(q, keypoint)));
            }
            if attribute == Attribute::Quat {
                row.copy_from_slice(&unit_quat([row[0], row[1], row[2], row[3]]));
            }
        });
        values
    }

    /// By [`Attribute::index`]: mean number of keypoints of a track; 0 for a scene without Gaussians.
    pub fn keypoints_mean(&self) -> Vec<f64> {
        let mean = |tracks: &Tracks<i16>| tracks.num_keypoints() as f64 / tracks.len().max(1) as f64;
        self.tracks.iter().map(mean).collect()
    }

    /// Checks the rules of the format. Counts agree, every width in use has quantizers, and codes fit their widths. The
    /// timesteps of a track rise strictly from the first to the last of its Gaussian's life; a constant track has only
    /// the timestep 0.
    pub(crate) fn check(&self) -> Result<(), Violation> {
        self.info.check(1)?;
        check_division(self.info.num_gaussians, &self.layers, self.segment_length)?;
        let of_columns =
            [self.bit_map.widths.len(), self.quantizers.attributes.len(), self.varies.len(), self.tracks.len()];
        if of_columns.iter().any(|&count| count != self.layout.columns().len()) {
            let problem = "not as many of widths, quantizers, tracks and what varies";
            return Err(Violation { attribute: None, field: "columns", problem });
        }
        if let Some(lives) = &self.lives {
            let is_legal = |life: &Life| life.birth < life.death && life.death <= self.info.num_timesteps;
            if lives.len() != self.num_gaussians() || !lives.iter().all(is_legal) {
                let problem = "not one within the timesteps for each Gaussian";
                return Err(Violation { attribute: None, field: "lives", problem });
            }
        }
        self.layout.attributes().try_for_each(|attribute| {
            let violation = |field, problem| Violation { attribute: Some(attribute), field, problem };
            self.check_quantizers(attribute)?;
            let components = attribute.components();
            let quantizers = self.quantizers.by_width(attribute);
            let widths = &self.bit_map.widths[attribute.index()];
            let tracks = &self.tracks[attribute.index()];
            if widths.len() != self.num_gaussians() {
                return Err(violation("bit widths", "not one for each Gaussian"));
            }
            if tracks.len() != self.num_gaussians() * components {
                return Err(violation("tracks", "not one for each Gaussian and channel"));
            }
            let may_lack = matches!(attribute, Attribute::Extra { .. });
            parallel::try_for_each(widths, |gaussian, &width| {
                if width == 0 && may_lack {
                    let of = gaussian * components..(gaussian + 1) * components;
                    let is_zero = |i| tracks.track(i) == (&[0][..], &[0][..]);
                    let problem = violation("codes", "not 0 of an attribute that the Gaussian lacks");
                    return if of.into_iter().all(is_zero) { Ok(()) } else { Err(problem) };
                }
                let quantizer = quantizers.get(usize::from(width)).and_then(|of_width| of_width.first());
                let quantizer = quantizer.ok_or(violation("bit widths", "a width without quantizers"))?;
                (gaussian * components..(gaussian + 1) * components).try_for_each(|i| {
                    let (times, codes) = tracks.track(i);
                    self.check_times(attribute, gaussian, times)
                        .map_err(|problem| violation("keypoint times", problem))?;
                    let legal = quantizer.min_code()..=quantizer.max_code();
                    if codes.iter().all(|&c| legal.contains(&i32::from(c))) {
                        Ok(())
                    } else {
                        Err(violation("codes", "a code outside its width"))
                    }
                })
            })
        })
    }

    fn check_quantizers(&self, attribute: Attribute) -> Result<(), Violation> {
        self.quantizers.attributes[attribute.index()].iter().try_for_each(|(&width, channels)| {
            let problem = if channels.len() != attribute.components() {
                Some("not one for each channel")
            } else if !(1..=MAX_BITS).contains(&width) || channels.iter().any(|q| q.bits != width) {
                Some("another width than its place says, or not within 1 to 16")
            } else {
                channels.iter().find_map(Quantizer::problem)
            };
            problem
                .map_or(Ok(()), |problem| Err(Violation { attribute: Some(attribute), field: "quantizers", problem }))
        })
    }

    fn check_times(&self, attribute: Attribute, gaussian: usize, times: &[u16]) -> Result<(), &'static str> {
        let life = self.lives.as_ref().map_or(Life { birth: 0, death: self.info.num_timesteps }, |l| l[gaussian]);
        match times {
            [] => Err("a track without keypoints"),
            [0] => Ok(()),
            _ if !self.varies[attribute.index()] => Err("several keypoints of an attribute that does not vary"),
            &[first, .., last] if [first.into(), u32::from(last) + 1] == [life.birth, life.death] => {
                if times.is_sorted_by(|a, b| a < b) { Ok(()) } else { Err("not increasing") }
            }
            _ => Err("not from the first to the last timestep of a life"),
        }
    }
}

/// Checks the rules for layers and for the length of segments.
pub(crate) fn check_division(num_gaussians: u32, layers: &[u32], segment_length: u32) -> Result<(), Violation> {
    let violation = |field, problem| Err(Violation { attribute: None, field, problem });
    let sum: u64 = layers.iter().map(|&n| u64::from(n)).sum();
    if sum != u64::from(num_gaussians) {
        violation("layers", "not as many Gaussians as the scene")
    } else if layers.contains(&0) || layers.len() > usize::from(u16::MAX) {
        violation("layers", "an empty one or more than 65535")
    } else if !(1..=MAX_TIMESTEPS).contains(&segment_length) {
        violation("segment_length", "not within 1 to 65536")
    } else {
        Ok(())
    }
}

/// The quaternion divided by its length; the identity if the length is zero.
pub(crate) fn unit_quat(quat: [f32; 4]) -> [f32; 4] {
    let unit = normalize(quat);
    // Lengths below about 1e-19 vanish when squared: `normalize` does not change such a quaternion.
    if unit.iter().map(|x| x * x).sum::<f32>() > 0.5 { unit } else { [1.0, 0.0, 0.0, 0.0] }
}

impl From<Violation> for CompressError {
    fn from(Violation { attribute, field, problem }: Violation) -> Self {
        Self::Scene { section: attribute.map_or("info", Attribute::name), field, problem }
    }
}
