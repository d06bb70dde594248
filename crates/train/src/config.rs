//! All settings of a training run, as `config.toml` holds them, and the presets.

use serde::{Deserialize, Serialize};
use tcgs_core::MAX_SH_DEGREE;

use crate::losses::WeightConfig;

/// A training run's settings: what `config.toml` holds. Every field can be set by its dotted name.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrainConfig {
    /// Which preset the settings started from.
    pub preset: Preset,
    /// Seed of every random choice. Default 0. TOML's integers are signed: from 2^63 on a file holds it less 2^64.
    #[serde(with = "signed")]
    pub seed: u64,
    /// The capture, its frames and their resolution.
    pub data: DataConfig,
    /// Numbers of iterations.
    pub schedule: ScheduleConfig,
    /// Learning rates of Adam.
    pub rates: RateConfig,
    /// Weights of the losses.
    pub weights: WeightConfig,
    /// Adaptive density control, first timestep only.
    pub densify: DensifyConfig,
    /// Learned masks (paper 4.1.1).
    pub mask: MaskConfig,
    /// Mixed-precision quantisation (paper 4.1.2).
    pub quantize: QuantizeConfig,
    /// Which Gaussians and tiles a timestep after the first trains.
    pub gate: GateConfig,
    /// Births after the first timestep.
    pub births: BirthConfig,
    /// Colours that depend on the direction of view.
    pub color: ColorConfig,
}

/// 64 bits as the signed integers that TOML has.
mod signed {
    use serde::{Deserialize, Deserializer, Serializer};

    pub fn serialize<S: Serializer>(value: &u64, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_i64(value.cast_signed())
    }

    pub fn deserialize<'a, D: Deserializer<'a>>(deserializer: D) -> Result<u64, D::Error> {
        i64::deserialize(deserializer).map(i64::cast_unsigned)
    }
}

/// A named set of settings.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Preset {
    /// Dynamic 3D Gaussians (Luiten et al. 2024): no masks, no quantisation, and the weight of the soft colour loss is
    /// 0, since a bug makes that loss inactive in the released code.
    D3dgs,
    /// The settings that the paper prints.
    Paper,
    /// The paper's settings, with those replaced that measured worse than an alternative.
    Default,
    /// `Default` with 4000 instead of 10000 iterations of the first timestep, and 300 instead of 2000 of each later
    /// one.
    Fast,
}

/// The capture that a run trains on: folder, frames, resolution.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DataConfig {
    /// The capture's folder, as given.
    pub capture: String,
    /// Name of the capture's kind, by which evaluation follows the conventions of publications. Default `panoptic`.
    pub layout: String,
    /// File of the initial points; empty: the capture's own. Default empty.
    pub points: String,
    /// Scene and timestep whose state the run starts from, as `/path/of/scene@12`; the first timestep is then trained as a
    /// later one. Empty: from points. Default empty.
    pub start_from: String,
    /// Index of the capture's frame that timestep 0 shows.
    pub first_frame: usize,
    /// One past the last frame.
    pub end_frame: usize,
    /// Images are averaged over this many pixels in both directions. Default 1.
    pub downscale: usize,
    /// Frames a second, for players.
    pub frame_rate: f64,
}

/// Numbers of iterations for which the constants of the reference are written: of the first timestep, and of each later
/// timestep.
pub const REFERENCE_ITERATIONS: [usize; 2] = [10_000, 2_000];

/// Numbers of iterations.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ScheduleConfig {
    /// Iterations of the first timestep. Default 10000 (reference).
    pub first_iterations: usize,
    /// Iterations of every later timestep. Default 2000 (reference).
    pub rest_iterations: usize,
}

/// Learning rates of Adam.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RateConfig {
    /// Means, times the scene's radius. Default 1.6e-4 (reference).
    pub mean: f32,
    /// Colours. Default 2.5e-3 (reference).
    pub color: f32,
    /// Coefficients of spherical harmonics, first timestep only. Default 1.25e-4, a twentieth of `color` (Kerbl et al. 2023).
    pub harmonic: f32,
    /// Colours after the first timestep. Reference 2.5e-3; default 5e-4, so that colours do not
    /// wander and their tracks stay simple.
    pub color_rest: f32,
    /// Rotations. Default 1e-3 (reference).
    pub quat: f32,
    /// Opacities, first timestep only. Default 0.05 (reference).
    pub logit_opacity: f32,
    /// Scales, first timestep only. Default 1e-3 (reference).
    pub log_scale: f32,
    /// Per-camera gain and offset, first timestep only. Default 1e-4 (reference).
    pub camera: f32,
    /// Mask logits, at the reference's number of iterations; multiplied by reference / actual. Default 0.01.
    pub mask: f32,
    /// Learned steps, times the step they start from. Paper 0.02; default 0.002, with which values keep
    /// up with their steps: the faster rate costs 0.2 dB.
    pub step: f32,
    /// What the means' and rotations' rates are multiplied by after the first timestep; 0: reference
    /// iterations / actual, so that a short schedule can still follow fast motion. Default 0.
    pub motion_scale: f32,
    /// Whether Adam's bias correction starts anew at every timestep. Reference false: the first steps
    /// are then about three times the rate. Default true, which follows motion better and drifts less.
    pub reset_steps: bool,
    /// Share of the rates of means, rotations, colours and steps left at the end of every timestep after
    /// the first, reached along a cosine. Reference 1: constant; default 0.02.
    pub motion_decay: f32,
    /// Likewise for every rate of the first timestep but the mask's. Reference 1; default 0.1.
    pub first_decay: f32,
    /// What the rates of scales, rotations, means and cameras of the first timestep are multiplied by; 0: the
    /// square root of reference iterations / actual. Reference 1; default 0.
    pub first_scale: f32,
}

/// Adaptive density control of the first timestep. Iterations are those of a 10000-iteration
/// schedule and scale with it; the interval does not.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DensifyConfig {
    /// First event. Default 500.
    pub start: usize,
    /// Last event. Default 5000.
    pub end: usize,
    /// Iterations between events. Default 100.
    pub interval: usize,
    /// Mean NDC gradient from which a Gaussian is cloned or split. Default 2e-4.
    pub gradient_threshold: f32,
    /// Largest scale, as a share of the scene's radius, up to which it is cloned rather than split. Default 0.01.
    pub clone_scale: f32,
    /// Children of a split. Default 2.
    pub split_children: usize,
    /// Children's scales are divided by this. Default 1.6.
    pub split_shrink: f32,
    /// Opacity below which a Gaussian is removed. Default 0.005.
    pub prune_opacity: f32,
    /// The same at the last event. Default 0.25.
    pub prune_opacity_end: f32,
    /// At this iteration opacities are reset, once; from it on Gaussians of a scale over `prune_scale` are
    /// removed. Default 3000.
    pub reset: usize,
    /// Share of the scene's radius. Default 0.1.
    pub prune_scale: f32,
    /// Opacity after the reset. Default 0.01.
    pub reset_opacity: f32,
}

/// Learned masks.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MaskConfig {
    /// Whether masks are learned.
    pub enabled: bool,
    /// `ε` of Eq. 1 and of the final pruning. Default 0.01.
    pub threshold: f32,
    /// Logit that masks start from. Default 1.
    pub initial_logit: f32,
    /// Start every timestep from `initial_logit` (the authors' fork) instead of the timestep before. Default false.
    pub reset: bool,
    /// Iterations, of 10000, between prunings in the first timestep; scales with the schedule. Default 1000.
    pub prune_interval: usize,
    /// Last such pruning, of 10000; what is masked later stays until all timesteps have voted. Reference
    /// 10000; default 6000, where quantisation starts.
    pub prune_end: usize,
}

/// The map from sensitivities to bit widths.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum BitMapKind {
    /// Least expected change of the images for `mean_bits` (`tcgs_codec::BitMapping::Log`).
    Log,
    /// The paper's min-max normalisation to `[min_bits, max_bits]` (`tcgs_codec::BitMapping::Linear`).
    Linear,
}

/// Quantisation inside the optimisation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct QuantizeConfig {
    /// Whether attributes are fake-quantised from `start` on.
    pub enabled: bool,
    /// Iteration, of 10000, at which sensitivities are measured and quantisation starts. Default 6000 (paper).
    pub start: usize,
    /// Fewest bits. Default 4 (paper).
    pub min_bits: u8,
    /// Most bits. Default 8 (paper).
    pub max_bits: u8,
    /// Mean bits of each attribute that the logarithmic map aims at. Default 5, about where the paper's [4, 8] ends up.
    pub mean_bits: f32,
    /// Sensitivity to bits. Default `log`; the paper's is `linear`.
    pub bit_map: BitMapKind,
    /// Bits of positions, quantised after training. Default 16 (paper).
    pub position_bits: u8,
    /// Whether quantizers learn an offset too (LSQ has none). Default true.
    pub learned_offset: bool,
}

/// Settings of the gate: what a timestep after the first trains.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GateConfig {
    /// Whether timesteps after the first train only what changes. Default true; false in `d3dgs` and `paper`.
    pub enabled: bool,
    /// A block of 4x4 pixels has changed if its mean absolute difference from the image before exceeds the median of all
    /// blocks of the view by so many standard deviations, estimated robustly, and by `contrast`. Default 6.
    pub noise: f32,
    /// See `noise`; in units of colour, of which white has 1. Default 0.006, one and a half of 255 levels.
    pub contrast: f32,
    /// A tile has evidence, too, if its mean absolute error has grown by more than this since it was last trained, in
    /// units of colour. Default 0.006.
    pub growth: f32,
    /// A Gaussian is active if at least this share of its blending weight, over all views, falls on changed blocks.
    /// Default 0.4; 0 makes every Gaussian active that a changed block shows.
    pub share: f32,
    /// A timestep has settled when its losses fell, over the last pass through its views, by less than this share of
    /// the most that they fell over one pass. Default 0.05.
    pub settle: f32,
    /// How many times as fast a timestep goes through the rest of its schedule once it has settled. Default 3; 1 to give
    /// every timestep all of its iterations.
    pub pace: f32,
}

impl GateConfig {
    /// The settings of presets `default` and `fast`.
    pub const ON: Self =
        Self { enabled: true, noise: 6.0, contrast: 0.006, growth: 0.006, share: 0.4, settle: 0.05, pace: 3.0 };

    /// The settings of presets that train everything, and of runs whose `config.toml` knows of no gate.
    pub const OFF: Self = Self { enabled: false, ..Self::ON };
}

/// Settings of births: Gaussians that later timesteps add.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BirthConfig {
    /// Whether timesteps after the first add Gaussians where the scene does not explain what is seen. Needs the gate;
    /// a run that continues another one's state adds none.
    /// Default true; false in `d3dgs` and `paper`.
    pub enabled: bool,
    /// A block of 4x4 pixels is not explained if its mean absolute error is above one and a half times that of its tile when last
    /// explained, the camera's noise, and this much; in units of colour. Default 0.02.
    pub contrast: f32,
    /// Most Gaussians that are born at a timestep, as a share of those that there are. Default 0.02.
    pub share: f32,
    /// Iterations in which they learn all their attributes, if all views see them. Default 200.
    pub iterations: usize,
    /// Opacity below which they are dropped afterwards. Default 0.1.
    pub opacity: f32,
}

impl BirthConfig {
    /// The settings of presets `default` and `fast`.
    pub const ON: Self = Self { enabled: true, contrast: 0.02, share: 0.02, iterations: 200, opacity: 0.1 };

    /// The settings of presets that add none, and of runs whose `config.toml` knows of no births.
    pub const OFF: Self = Self { enabled: false, ..Self::ON };
}

/// Settings of colours that depend on the direction of view.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ColorConfig {
    /// Highest degree of spherical harmonics, 0 to 3; 0: a colour is the same from everywhere. Default 0 (reference).
    pub degree: usize,
}

/// Why [`TrainConfig::merge`] or [`TrainConfig::set`] refused settings.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ConfigError {
    /// No setting has this name.
    #[error("unknown setting {key}, expected {expected}")]
    UnknownKey {
        /// Dotted name of the setting, as given.
        key: String,
        /// The names that exist at this place.
        expected: String,
    },
    /// The value is of the wrong type or out of range.
    #[error("{key} is {found}, expected {expected}")]
    Value {
        /// Dotted name of the setting.
        key: String,
        /// The value, as given.
        found: String,
        /// The type or range that is valid.
        expected: String,
    },
    /// The text is not TOML, or not of the form of a `config.toml`.
    #[error("not a configuration: {0}")]
    Syntax(String),
}

impl Default for TrainConfig {
    fn default() -> Self {
        Self::preset(Preset::Default)
    }
}

impl TrainConfig {
    /// The settings of a preset.
    ///
    /// ```
    /// use tcgs_train::{Preset, TrainConfig};
    /// assert!(!TrainConfig::preset(Preset::D3dgs).mask.enabled);
    /// ```
    pub fn preset(preset: Preset) -> Self {
        let reference = Self {
            preset,
            seed: 0,
            data: DataConfig {
                capture: String::new(),
                layout: "panoptic".into(),
                points: String::new(),
                start_from: String::new(),
                first_frame: 0,
                end_frame: 0,
                downscale: 1,
                frame_rate: 30.0,
            },
            schedule: ScheduleConfig {
                first_iterations: REFERENCE_ITERATIONS[0],
                rest_iterations: REFERENCE_ITERATIONS[1],
            },
            rates: RateConfig {
                mean: 1.6e-4,
                color: 2.5e-3,
                harmonic: 1.25e-4,
                color_rest: 2.5e-3,
                quat: 1e-3,
                logit_opacity: 0.05,
                log_scale: 1e-3,
                camera: 1e-4,
                mask: 0.01,
                step: 0.02,
                motion_scale: 0.0,
                reset_steps: false,
                motion_decay: 1.0,
                first_decay: 1.0,
                first_scale: 1.0,
            },
            weights: WeightConfig::REFERENCE,
            densify: DensifyConfig {
                start: 500,
                end: 5000,
                interval: 100,
                gradient_threshold: 2e-4,
                clone_scale: 0.01,
                split_children: 2,
                split_shrink: 1.6,
                prune_opacity: 0.005,
                prune_opacity_end: 0.25,
                reset: 3000,
                prune_scale: 0.1,
                reset_opacity: 0.01,
            },
            mask: MaskConfig {
                enabled: true,
                threshold: 0.01,
                initial_logit: 1.0,
                reset: false,
                prune_interval: 1000,
                prune_end: 10_000,
            },
            quantize: QuantizeConfig {
                enabled: true,
                start: 6000,
                min_bits: 4,
                max_bits: 8,
                mean_bits: 5.0,
                bit_map: BitMapKind::Log,
                position_bits: 16,
                learned_offset: true,
            },
            gate: GateConfig::OFF,
            births: BirthConfig::OFF,
            color: ColorConfig { degree: 0 },
        };
        let mut config = reference;
        match preset {
            Preset::D3dgs => {
                config.mask.enabled = false;
                config.quantize.enabled = false;
                config.weights.soft_color = 0.0;
            }
            Preset::Paper => {
                config.quantize.bit_map = BitMapKind::Linear;
                config.quantize.learned_offset = false;
            }
            Preset::Default | Preset::Fast => {
                config.rates.first_scale = 0.0;
                config.rates.first_decay = 0.1;
                config.rates.motion_decay = 0.02;
                config.rates.reset_steps = true;
                config.rates.step = 0.002;
                config.rates.color_rest = 5e-4;
                config.weights.mask = 0.05;
                config.weights.mask_consistency = 0.5;
                config.mask.prune_end = 6000;
                config.gate = GateConfig::ON;
                config.births = BirthConfig::ON;
            }
        }
        if preset == Preset::Fast {
            config.schedule = ScheduleConfig { first_iterations: 4000, rest_iterations: 300 };
        }
        config
    }

    /// Parses a `config.toml`. Fields that it leaves out keep the values of `self`.
    ///
    /// # Errors
    /// [`ConfigError`] for a field that does not exist, or a value of another type or range.
    pub fn merge(&self, text: &str) -> Result<Self, ConfigError> {
        let table: toml::Table = text.parse().map_err(|e: toml::de::Error| ConfigError::Syntax(one_line(&e)))?;
        let mut own = self.table();
        merge_into(&mut own, table, "")?;
        Self::from_table(own)
    }

    /// Sets one field by its dotted name.
    ///
    /// - `key`: dotted name, such as `weights.rigid`
    /// - `value`: a TOML value; a text that is not TOML is taken as a string
    ///
    /// ```
    /// let mut config = tcgs_train::TrainConfig::default();
    /// config.set("weights.rigid", "2.5").unwrap();
    /// assert_eq!(config.weights.rigid, 2.5);
    /// assert!(config.set("weights.rigit", "2.5").unwrap_err().to_string().starts_with("unknown setting weights.rigit"));
    /// ```
    ///
    /// # Errors
    /// As [`Self::merge`].
    pub fn set(&mut self, key: &str, value: &str) -> Result<(), ConfigError> {
        // A bare word is a string: TOML would want quotes.
        let parsed: toml::Value =
            value.parse::<toml::Value>().unwrap_or_else(|_| toml::Value::String(value.to_owned()));
        let mut nested = parsed;
        for part in key.rsplit('.') {
            nested = toml::Value::Table(toml::Table::from_iter([(part.to_owned(), nested)]));
        }
        let toml::Value::Table(nested) = nested else { unreachable!("wrapped at least once") };
        let mut own = self.table();
        merge_into(&mut own, nested, "")?;
        *self = Self::from_table(own)?;
        Ok(())
    }

    /// The text of a `config.toml`.
    pub fn to_toml(&self) -> String {
        toml::to_string(self).expect("plain settings have a TOML form")
    }

    /// Dotted name of the first field, in the order of `config.toml`, in which two configurations differ; `None` if
    /// they are equal.
    pub fn first_difference(&self, other: &Self) -> Option<String> {
        fn walk(a: &toml::Table, b: &toml::Table, prefix: &str) -> Option<String> {
            a.iter().find_map(|(key, value)| match (value, &b[key]) {
                (toml::Value::Table(a), toml::Value::Table(b)) => walk(a, b, &format!("{prefix}{key}.")),
                (a, b) => (a != b).then(|| format!("{prefix}{key}")),
            })
        }
        walk(&self.table(), &other.table(), "")
    }

    fn table(&self) -> toml::Table {
        toml::Table::try_from(self).expect("plain settings have a TOML form")
    }

    fn from_table(table: toml::Table) -> Result<Self, ConfigError> {
        let config: Self = table.try_into().map_err(|e: toml::de::Error| ConfigError::Syntax(one_line(&e)))?;
        config.check()?;
        Ok(config)
    }

    fn check(&self) -> Result<(), ConfigError> {
        let refuse = |key: &str, found: String, expected: &str| {
            Err(ConfigError::Value { key: key.into(), found, expected: expected.into() })
        };
        for (section, values) in self.table() {
            for (name, value) in values.as_table().into_iter().flatten() {
                let key = format!("{section}.{name}");
                if let Some(x) = value.as_float()
                    && !(x.is_finite() && (x >= 0.0 || key == "mask.initial_logit"))
                {
                    return refuse(&key, x.to_string(), "a finite number, 0 or more");
                }
            }
        }
        if self.densify.split_children == 0 || self.densify.split_shrink == 0.0 {
            return refuse("densify.split_children or split_shrink", "0".into(), "more than 0");
        }
        let q = &self.quantize;
        if q.min_bits < 1 || q.min_bits > q.max_bits || q.max_bits > 16 {
            return refuse(
                "quantize.min_bits,max_bits",
                format!("{},{}", q.min_bits, q.max_bits),
                "1 <= min <= max <= 16",
            );
        }
        if !(1..=16).contains(&q.position_bits) {
            return refuse("quantize.position_bits", q.position_bits.to_string(), "1 to 16");
        }
        if self.schedule.first_iterations == 0 || self.schedule.rest_iterations == 0 {
            return refuse("schedule", "0 iterations".into(), "at least 1");
        }
        if self.data.downscale == 0 {
            return refuse("data.downscale", "0".into(), "at least 1");
        }
        if self.color.degree > MAX_SH_DEGREE {
            return refuse("color.degree", self.color.degree.to_string(), "0 to 3");
        }
        if self.gate.pace < 1.0 {
            return refuse("gate.pace", self.gate.pace.to_string(), "1 or more");
        }
        if self.births.iterations == 0 || self.births.share == 0.0 {
            return refuse(
                "births.iterations or births.share",
                "0".into(),
                "more than 0 (births.enabled turns births off)",
            );
        }
        if self.densify.interval == 0 || self.mask.prune_interval == 0 {
            return refuse("densify.interval or mask.prune_interval", "0".into(), "at least 1");
        }
        if !(0.0..1.0).contains(&self.mask.threshold) {
            return refuse("mask.threshold", self.mask.threshold.to_string(), "0 to 1");
        }
        Ok(())
    }
}

fn one_line(error: &toml::de::Error) -> String {
    error.message().replace('\n', " ")
}

fn merge_into(own: &mut toml::Table, given: toml::Table, prefix: &str) -> Result<(), ConfigError> {
    for (key, value) in given {
        let name = format!("{prefix}{key}");
        let names = own.keys().map(|k| format!("{prefix}{k}")).collect::<Vec<_>>().join(", ");
        let Some(slot) = own.get_mut(&key) else {
            return Err(ConfigError::UnknownKey { key: name, expected: format!("one of {names}") });
        };
        match (slot, value) {
            (toml::Value::Table(own), toml::Value::Table(given)) => merge_into(own, given, &format!("{name}."))?,
            (toml::Value::Float(own), toml::Value::Integer(given)) => *own = given as f64,
            (slot, value) if slot.same_type(&value) => *slot = value,
            (slot, value) => {
                let expected = format!("a value of type {}", slot.type_str());
                return Err(ConfigError::Value { key: name, found: value.to_string(), expected });
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_preset_survives_its_file() {
        for preset in [Preset::D3dgs, Preset::Paper, Preset::Default, Preset::Fast] {
            let config = TrainConfig::preset(preset);
            assert_eq!(TrainConfig::default().merge(&config.to_toml()).unwrap(), config);
            let config = TrainConfig { seed: u64::MAX, ..config };
            assert_eq!(TrainConfig::default().merge(&config.to_toml()).unwrap(), config);
        }
    }

    #[test]
    fn settings_are_set_by_name_or_refused() {
        let mut config = TrainConfig::default();
        config.set("schedule.first_iterations", "7").unwrap();
        config.set("rates.mean", "1").unwrap();
        config.set("quantize.bit_map", "linear").unwrap();
        config.set("mask.enabled", "false").unwrap();
        assert_eq!((config.schedule.first_iterations, config.rates.mean, config.mask.enabled), (7, 1.0, false));
        assert_eq!(config.quantize.bit_map, BitMapKind::Linear);
        for (key, value, message) in [
            ("mask.treshold", "0.1", "unknown setting mask.treshold, expected one of mask.enabled"),
            ("mask", "0.1", "mask is 0.1, expected a value of type table"),
            ("mask.threshold", "high", "mask.threshold is \"high\", expected a value of type float"),
            ("quantize.min_bits", "9", "quantize.min_bits,max_bits is 9,8"),
            ("quantize.bit_map", "cubic", "not a configuration"),
            ("weights.rigid", "nan", "weights.rigid is NaN, expected a finite number"),
            ("rates.mean", "-1.0", "rates.mean is -1, expected"),
            ("gate.pace", "0.5", "gate.pace is 0.5, expected 1 or more"),
            ("color.degree", "4", "color.degree is 4, expected 0 to 3"),
            (
                "births.share",
                "0.0",
                "births.iterations or births.share is 0, expected more than 0 (births.enabled turns births off)",
            ),
        ] {
            let error = config.clone().set(key, value).unwrap_err().to_string();
            assert!(error.contains(message), "{error}");
        }
        assert_eq!(config.first_difference(&TrainConfig::default()).as_deref(), Some("mask.enabled"));
    }
}
