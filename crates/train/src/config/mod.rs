//! All settings of a training run, as `config.toml` holds them, and the presets.

mod bounds;
mod groups;
mod retired;

use serde::{Deserialize, Serialize};
use tcgs_codec::BitSettings;

pub use self::groups::{
    BirthConfig, BitMapKind, ColorConfig, DataConfig, DeathConfig, DensifyConfig, GateConfig, MaskConfig,
    QuantizeConfig, REFERENCE_ITERATIONS, RateConfig, RenderConfig, ScheduleConfig,
};
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
    /// Deaths after the first timestep.
    pub deaths: DeathConfig,
    /// Colours that depend on the direction of view.
    pub color: ColorConfig,
    /// How the Gaussians are drawn.
    pub render: RenderConfig,
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
#[non_exhaustive]
pub enum Preset {
    /// Dynamic 3D Gaussians (Luiten et al. 2024): no masks, no quantisation, and the weight of the soft colour loss is
    /// 0, since a bug makes that loss inactive in the released code.
    D3dgs,
    /// The settings that the paper prints.
    Paper,
    /// The paper's settings, with those replaced that measured worse than an alternative.
    Default,
    /// `Default` with 2500 instead of 10000 iterations of the first timestep, and 300 instead of 2000 of each later
    /// one.
    Fast,
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
    /// Most bytes of a `config.toml` that is read. [`Self::to_toml`] writes one to two thousand.
    pub const MAX_BYTES: u64 = 1 << 20;

    /// The settings of a preset.
    ///
    /// ```
    /// use tcgs_train::{Preset, TrainConfig};
    /// assert!(!TrainConfig::preset(Preset::D3dgs).mask.enabled);
    /// ```
    pub fn preset(preset: Preset) -> Self {
        let bits = BitSettings::default();
        let reference = Self {
            preset,
            seed: 0,
            data: DataConfig {
                capture: String::new(),
                layout: "panoptic".into(),
                points: String::new(),
                hold_out: Vec::new(),
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
                color_damping: 0.0,
                harmonic: 1.25e-4,
                color_rest: 2.5e-3,
                quat: 1e-3,
                logit_opacity: 0.05,
                log_scale: 1e-3,
                camera: 1e-4,
                camera_centered: false,
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
                interval: 100,
                gradient_threshold: 2e-4,
                prune_opacity_end: 0.25,
                reset: 3000,
                prune_large: 3000,
                prune_error: 0.0,
                dropout: 0.0,
            },
            mask: MaskConfig { enabled: true, threshold: 0.01, initial_logit: 1.0, reset: false, prune_end: 10_000 },
            quantize: QuantizeConfig {
                enabled: true,
                start: 6000,
                min_bits: bits.min_bits,
                max_bits: bits.max_bits,
                mean_bits: bits.mean_bits,
                bit_map: BitMapKind::Log,
                learned_offset: true,
            },
            gate: GateConfig::OFF,
            births: BirthConfig::OFF,
            deaths: DeathConfig::OFF,
            color: ColorConfig { degree: 0 },
            render: RenderConfig::OFF,
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
                config.rates.color_damping = 0.3;
                config.rates.camera_centered = true;
                // Less of what holds motion together, and much less of outlines, at which Gaussians would gather.
                config.weights = WeightConfig {
                    segmentation: 0.5,
                    rigid: 2.0,
                    rot: 2.0,
                    iso: 1.0,
                    floor: 1.0,
                    background: 10.0,
                    soft_color: 0.005,
                    ..WeightConfig::REFERENCE
                };
                config.mask.enabled = false;
                config.mask.prune_end = 6000;
                config.densify.prune_error = 1.0;
                config.densify.dropout = 0.4;
                config.densify.prune_opacity_end = DensifyConfig::PRUNE_OPACITY;
                // Antialiased splats have larger gradients.
                config.densify.gradient_threshold = 3e-4;
                config.render.antialiased = true;
                (config.densify.reset, config.densify.prune_large) = (0, 0);
                config.gate = GateConfig::ON;
                config.births = BirthConfig::ON;
                config.deaths = DeathConfig::ON;
            }
        }
        if preset == Preset::Fast {
            config.schedule = ScheduleConfig { first_iterations: 2500, rest_iterations: 300 };
        }
        config
    }

    /// Parses a `config.toml`. Fields that it leaves out keep the values of `self`. A retired setting is passed over if
    /// it has the value of its constant.
    ///
    /// # Errors
    /// [`ConfigError`] for a field that does not exist, a value of another type or range, or a retired setting with
    /// another value.
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
    /// let unknown = config.set("weights.rigit", "2.5").unwrap_err();
    /// assert!(unknown.to_string().starts_with("unknown setting weights.rigit"));
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
        // Before numbers are rounded to the types of their fields.
        bounds::check(&table)?;
        let config: Self = table.try_into().map_err(|e: toml::de::Error| ConfigError::Syntax(one_line(&e)))?;
        config.check()?;
        Ok(config)
    }

    /// Checks every setting, for fields that were set without [`Self::set`].
    ///
    /// # Errors
    /// [`ConfigError::Value`] for a value that is out of range, or that another setting excludes.
    pub fn check(&self) -> Result<(), ConfigError> {
        bounds::check(&self.table())?;
        let q = &self.quantize;
        if q.min_bits > q.max_bits {
            let key = "quantize.min_bits,max_bits".into();
            let (found, expected) = (format!("{},{}", q.min_bits, q.max_bits), "1 <= min <= max <= 16".into());
            return Err(ConfigError::Value { key, found, expected });
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
            if retired::is_retired(&name, &value)? {
                continue;
            }
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
    fn preset_paper_has_what_the_paper_prints() {
        let paper = TrainConfig::preset(Preset::Paper);
        let (w, m, q, d) = (&paper.weights, &paper.mask, &paper.quantize, &paper.densify);
        assert_eq!((paper.schedule.first_iterations, paper.schedule.rest_iterations), (10_000, 2_000));
        assert_eq!((w.image, w.segmentation, w.rigid, w.rot, w.iso), (1.0, 3.0, 4.0, 4.0, 2.0));
        assert_eq!((w.floor, w.background, w.soft_color, w.stillness), (2.0, 20.0, 0.01, 0.0));
        assert_eq!((w.mask, w.mask_consistency), (0.01, 0.01));
        assert_eq!((m.enabled, m.threshold, m.initial_logit, m.reset), (true, 0.01, 1.0, false));
        assert_eq!((q.enabled, q.start, q.min_bits, q.max_bits), (true, 6000, 4, 8));
        assert_eq!((q.mean_bits, q.bit_map, q.learned_offset), (5.0, BitMapKind::Linear, false));
        assert_eq!((d.start, d.interval, d.reset, d.prune_large), (500, 100, 3000, 3000));
        assert_eq!((d.gradient_threshold, d.prune_opacity_end), (2e-4, 0.25));
        let r = &paper.rates;
        assert_eq!([d.prune_error, d.dropout, r.color_damping], [0.0; 3]);
        assert_eq!((r.step, r.mask, r.color_rest, r.motion_decay), (0.02, 0.01, r.color, 1.0));
        assert_eq!((r.first_decay, r.first_scale, r.reset_steps, r.camera_centered), (1.0, 1.0, false, false));
        assert_eq!(
            (&paper.gate, &paper.births, &paper.deaths),
            (&GateConfig::OFF, &BirthConfig::OFF, &DeathConfig::OFF)
        );
        assert_eq!((paper.color.degree, paper.render.antialiased), (0, false));
    }

    #[test]
    fn settings_are_set_by_name_or_refused() {
        let mut config = TrainConfig::default();
        config.set("schedule.first_iterations", "7").unwrap();
        config.set("rates.mean", "1").unwrap();
        config.set("quantize.bit_map", "linear").unwrap();
        config.set("mask.enabled", "true").unwrap();
        assert_eq!((config.schedule.first_iterations, config.rates.mean, config.mask.enabled), (7, 1.0, true));
        assert_eq!(config.quantize.bit_map, BitMapKind::Linear);
        for (key, value, message) in [
            ("mask.treshold", "0.1", "unknown setting mask.treshold, expected one of mask.enabled"),
            ("mask", "0.1", "mask is 0.1, expected a value of type table"),
            ("mask.threshold", "high", "mask.threshold is \"high\", expected a value of type float"),
            ("quantize.min_bits", "9", "quantize.min_bits,max_bits is 9,8"),
            ("quantize.bit_map", "cubic", "not a configuration"),
            ("weights.rigid", "nan", "weights.rigid is NaN, expected a number from 0 to 1000000"),
            ("rates.mean", "-1.0", "rates.mean is -1, expected"),
            ("gate.share", "1.5", "gate.share is 1.5, expected a number from 0 to 1"),
            ("deaths.share", "1.0", "deaths.share is 1, expected a number from 0 to 0.999"),
            ("color.degree", "4", "color.degree is 4, expected a whole number from 0 to 3"),
            ("births.share", "0.0", "births.share is 0, expected a number from 0.000001 to 1"),
            ("quantize.min_bits", "300", "quantize.min_bits is 300, expected a whole number from 1 to 16"),
        ] {
            let error = config.clone().set(key, value).unwrap_err().to_string();
            assert!(error.contains(message), "{error}");
        }
        assert_eq!(config.first_difference(&TrainConfig::default()).as_deref(), Some("mask.enabled"));
    }
}
