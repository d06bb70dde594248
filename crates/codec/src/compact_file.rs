//! All codes of a file: its cohorts and their common description.

use std::sync::Arc;

use tcgs_core::{Gaussians, Layout};

use crate::attached::{Light, MAX_BYTES, read_background, read_light};
use crate::bitstream::decode_archive;
use crate::compact::{CompactScene, SceneInfo};
use crate::error::DecodeError;
use crate::limits::DecodeLimits;

/// A compressed scene before entropy coding: one [`CompactScene`], or several with different spans of timesteps.
///
/// ```
/// use tcgs_codec::{BitMap, CompactFile, CompressSettings, DecodeLimits, SceneInfo, compress};
/// use tcgs_core::{DynamicGaussians, Gaussians};
/// let mut scene = DynamicGaussians::default();
/// scene.push(Gaussians::zeros(3));
/// let (map, info, settings) = (BitMap::uniform(3, 16, 6), SceneInfo::of(&scene), CompressSettings::default());
/// let compact = CompactFile::of(compress(&scene, &map, None, info, &settings)?);
/// assert_eq!(compact.oldest_version(), 1);
/// let file = compact.encode(2, &[])?;
/// assert_eq!(CompactFile::decode(&file, &DecodeLimits::default())?, compact);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct CompactFile {
    /// Description of the whole scene; its counts are those of all cohorts together.
    pub info: SceneInfo,
    /// By ascending [`CompactScene::start`], all with the same layout.
    pub cohorts: Vec<CompactScene>,
    /// By name of the attribute: the largest error against the compressed scene, from
    /// [`AttributeErrors::declared`](crate::AttributeErrors::declared). Version 1 of the format does not hold them.
    pub declared_errors: Vec<(String, f32)>,
    /// Gains of all colours over time. [`Self::at`] does not apply them.
    pub light: Light,
}

impl CompactFile {
    /// A file of one scene, whose Gaussians are described together.
    pub fn of(scene: CompactScene) -> Self {
        Self { info: scene.info.clone(), cohorts: vec![scene], declared_errors: Vec::new(), light: Light::default() }
    }

    /// Decodes a whole `.tcgs` file of any version.
    ///
    /// - `file`: all bytes of the file
    /// - `limits`: bounds on memory and counts
    ///
    /// # Errors
    /// As [`decode`](crate::decode()).
    pub fn decode(file: &[u8], limits: &DecodeLimits) -> Result<Self, DecodeError> {
        let (archive, mut cohorts) = decode_archive(file, limits)?;
        let (info, declared_errors) = (archive.info().clone(), archive.declared_errors().to_vec());
        // Other application data, such as sounds, may be larger than light and background ever are.
        let is_short = |(_, data): &(String, &[u8])| data.len() <= MAX_BYTES;
        let short = archive.application_data_in(file)?.into_iter().filter(is_short);
        let data: Vec<_> = short.map(|(name, data)| (name, data.to_vec())).collect();
        let background = read_background(&data);
        cohorts.iter_mut().for_each(|cohort| cohort.layout = cohort.layout.with_background(background));
        Ok(Self { info, cohorts, declared_errors, light: read_light(&data) })
    }

    /// Encodes a `.tcgs` file.
    ///
    /// - `version`: of the format, 1 or 2
    /// - `data`: name and content of each piece of application data. Light and background come before them, unless
    ///   they are among them
    ///
    /// # Errors
    /// [`CompressError::Unsupported`](crate::CompressError::Unsupported) if the version does not hold the scene; else
    /// as [`encode_with`](crate::encode_with()) and [`FileWriter::declaring`](crate::FileWriter::declaring).
    #[cfg(feature = "encode")]
    pub fn encode(&self, version: u16, data: &[(&str, &[u8])]) -> Result<Vec<u8>, crate::CompressError> {
        let light = (self.light != Light::default()).then(|| self.light.to_json());
        let background = self.layout().background();
        let background = (background != [0; 3]).then(|| crate::write_background(background));
        // A player looks for application data at the start of a file, and stops at the first large piece.
        let own = [(crate::LIGHT, light.as_deref()), (crate::BACKGROUND, background.as_deref())];
        let own = own.into_iter().filter_map(|(name, json)| Some((name, json?)));
        let is_given = |name: &str| data.iter().any(|(given, _)| *given == name);
        let data: Vec<_> = own.filter(|(name, _)| !is_given(name)).chain(data.iter().copied()).collect();
        match (version, &self.cohorts[..]) {
            (1, [only]) => crate::encode_with(only, &data),
            (1, _) => {
                let found = format!("{} cohorts", self.cohorts.len());
                Err(crate::CompressError::Unsupported { version: 1, found })
            }
            _ => {
                let mut file = std::io::Cursor::new(Vec::new());
                let (info, errors) = (&self.info, &self.declared_errors);
                let mut writer = crate::FileWriter::declaring(&mut file, info, errors, &data, self.cohorts.len())?;
                self.cohorts.iter().try_for_each(|cohort| writer.add(cohort))?;
                writer.finish()?;
                Ok(file.into_inner())
            }
        }
    }

    /// The oldest version of the format that holds the scene, though perhaps not its declared errors.
    pub fn oldest_version(&self) -> u16 {
        match &self.cohorts[..] {
            [only]
                if only.layout.is_base()
                    && !only.layout.is_antialiased()
                    && only.lives.is_none()
                    && only.start == 0 =>
            {
                1
            }
            _ => 2,
        }
    }

    /// Number of identities: of the Gaussians of all cohorts together.
    pub fn num_identities(&self) -> usize {
        self.info.num_gaussians as usize
    }

    /// Number of Gaussians that live at a timestep.
    pub fn num_gaussians_at(&self, timestep: usize) -> usize {
        self.cohorts.iter().map(|cohort| cohort.num_alive_at(timestep)).sum()
    }

    /// Number of timesteps.
    pub fn num_timesteps(&self) -> usize {
        self.info.num_timesteps as usize
    }

    /// Which columns the Gaussians have.
    pub fn layout(&self) -> Arc<Layout> {
        self.cohorts.first().map_or_else(Layout::base, |cohort| Arc::clone(&cohort.layout))
    }

    /// The Gaussians that live at a timestep as floats, in stored form, cohort by cohort.
    pub fn at(&self, timestep: usize) -> Gaussians {
        let mut parts: Vec<Gaussians> = self.cohorts.iter().filter_map(|cohort| cohort.alive_at(timestep)).collect();
        if parts.len() == 1 { parts.remove(0) } else { Gaussians::concat(&self.layout(), &parts) }
    }

    /// By [`Attribute::index`](tcgs_core::Attribute::index): mean number of keypoints of a track.
    pub fn keypoints_mean(&self) -> Vec<f64> {
        let sum = |a: usize| {
            let tracks = self.cohorts.iter().map(|cohort| &cohort.tracks[a]);
            let (keypoints, count) =
                tracks.fold((0, 0), |(keypoints, count), of| (keypoints + of.num_keypoints(), count + of.len()));
            keypoints as f64 / count.max(1) as f64
        };
        (0..self.layout().columns().len()).map(sum).collect()
    }

    /// Mean width of all codes over Gaussians, in bits.
    pub fn mean_bits(&self) -> f64 {
        let weighted: f64 = self.cohorts.iter().map(|c| c.bit_map.mean_bits() * c.num_gaussians() as f64).sum();
        weighted / self.num_identities().max(1) as f64
    }

    /// Sum of [`CompactScene::plain_bytes`].
    pub fn plain_bytes(&self) -> u64 {
        self.cohorts.iter().map(CompactScene::plain_bytes).sum()
    }

    /// Sum of [`CompactScene::quantized_bytes`].
    pub fn quantized_bytes(&self) -> u64 {
        self.cohorts.iter().map(CompactScene::quantized_bytes).sum()
    }
}

#[cfg(all(test, feature = "encode"))]
mod tests {
    use std::io::Cursor;

    use tcgs_core::{DynamicGaussians, Gaussians};

    use super::*;
    use crate::{BitMap, CompressSettings, SceneFile, SegmentCache, compress};

    #[test]
    fn a_file_holds_its_light_and_its_background() {
        let mut floats = DynamicGaussians::default();
        (0..6).for_each(|_| floats.push(Gaussians::zeros(3)));
        let (map, info, settings) = (BitMap::uniform(3, 16, 6), SceneInfo::of(&floats), CompressSettings::default());
        let plain = CompactFile::of(compress(&floats, &map, None, info, &settings).unwrap());
        let gains: Vec<[f32; 3]> = (0..6).map(|t| [1.0, 1.0 + 0.03 * t as f32, 0.5]).collect();
        let mut lit = CompactFile { light: Light::through(&gains), ..plain.clone() };
        lit.cohorts[0].layout = lit.layout().with_background([9, 0, 255]);
        let other = ("x.notes", &b"a red ball"[..]);
        for version in [1, 2] {
            let file = lit.encode(version, &[other]).unwrap();
            let decoded = CompactFile::decode(&file, &DecodeLimits::none()).unwrap();
            assert_eq!(decoded, lit);
            assert_eq!(decoded.at(4), plain.at(4).with_background([9, 0, 255]));
            let mut read =
                SceneFile::open(Cursor::new(file), &DecodeLimits::none(), SegmentCache::DEFAULT_BYTES).unwrap();
            assert_eq!(read.light().at(5), [1.0, 1.15, 0.5]);
            assert_eq!((read.at(4).unwrap(), read.layout()), (decoded.at(4), &lit.layout()));
            assert_eq!(read.application_data().unwrap()[2], (other.0.to_owned(), other.1.to_vec()));
            let plain = plain.encode(version, &[other]).unwrap();
            let plain = CompactFile::decode(&plain, &DecodeLimits::none()).unwrap();
            assert_eq!((plain.light, plain.cohorts[0].layout.background()), (Light::default(), [0; 3]));
        }
    }
}
