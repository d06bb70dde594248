//! Largest errors: the errors that a file declares hold for the decoded values, and settings reduce them.

use std::io::Cursor;
use std::sync::Arc;

use tcgs_codec::{
    AttributeErrors, BitMap, CompactFile, CompactScene, CompressError, CompressSettings, DecodeLimits, FileWriter,
    FollowedParts, Light, SceneFile, SceneInfo, SegmentCache, compress_ordered, inspect,
};
use tcgs_core::{Attribute, DynamicGaussians, Gaussians, Layout, Life};

/// Pseudo-random numbers in [0, 1).
fn random(i: usize) -> f32 {
    let mut z = (i as u64 + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    z = (z ^ z >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    ((z ^ z >> 27) >> 40) as f32 / (1 << 24) as f32
}

/// Gaussians that move, turn, fade and have harmonics, at different speeds; one is an outlier in every attribute.
fn scene(num_gaussians: usize, num_timesteps: usize, layout: &Arc<Layout>) -> DynamicGaussians {
    let mut scene = DynamicGaussians::new(Arc::clone(layout));
    for timestep in 0..num_timesteps {
        let mut now = Gaussians::zeros_of(layout, num_gaussians);
        for column in layout.columns() {
            let components = column.components();
            for (i, x) in now.values_mut(column.attribute).iter_mut().enumerate() {
                let speed = [0.0, 0.02, 0.3][i / components % 3];
                let wave = (0.4 * timestep as f32 + i as f32).sin();
                let far = if i / components == 7 { 6.0 } else { 1.0 };
                *x = far * (random(i + 1000 * column.attribute.index()) - 0.5 + speed * wave);
            }
        }
        scene.push(now);
    }
    scene
}

fn settings() -> CompressSettings {
    CompressSettings { coarser: [0.0; 5], segment_length: Some(6), ..CompressSettings::default() }
}

/// The scene as symbols with its declared errors, and its order.
fn compress(scene: &DynamicGaussians, settings: &CompressSettings) -> (CompactFile, Vec<usize>) {
    let bits = BitMap::uniform_of(scene.layout(), scene.num_gaussians(), 12, 6);
    let (compact, order) = compress_ordered(scene, &bits, None, SceneInfo::of(scene), settings).unwrap();
    let errors = AttributeErrors::of(&compact, &mut &*scene, &order).unwrap();
    (CompactFile { declared_errors: errors.declared(), ..CompactFile::of(compact) }, order)
}

#[test]
fn what_is_declared_holds_for_what_is_decoded_and_no_less_would() {
    let layout = Layout::with_harmonics(2);
    let scene = scene(40, 14, &layout);
    let (compact, order) = compress(&scene, &settings());
    let file = compact.encode(2, &[]).unwrap();
    assert_eq!(inspect(&file, &DecodeLimits::default()).unwrap().declared_errors, compact.declared_errors);
    assert_eq!(CompactFile::decode(&file, &DecodeLimits::default()).unwrap(), compact);

    let mut decoded =
        SceneFile::open(Cursor::new(file), &DecodeLimits::default(), SegmentCache::DEFAULT_BYTES).unwrap();
    let mut found = AttributeErrors::none(&layout);
    for timestep in 0..14 {
        found.add(&scene.at(timestep).select(&order), &decoded.at(timestep).unwrap());
    }
    assert_eq!(decoded.archive().declared_errors().len(), layout.columns().len());
    for ((name, found), (declared_name, declared)) in
        found.by_name().into_iter().zip(decoded.archive().declared_errors())
    {
        let declared = f64::from(*declared);
        assert_eq!(name, declared_name);
        assert!(found <= declared && declared < 1.000_01 * found && found > 0.0, "{name}: {found} of {declared}");
    }
    // Version 1 cannot store them.
    let (compact, _) = compress(&self::scene(40, 3, &Layout::base()), &settings());
    let decoded = CompactFile::decode(&compact.encode(1, &[]).unwrap(), &DecodeLimits::default()).unwrap();
    assert_eq!((decoded.declared_errors, decoded.cohorts), (Vec::new(), compact.cohorts));
}

#[test]
fn gaussians_count_while_they_live() {
    let scene = scene(9, 8, &Layout::base());
    let (compact, order) = compress(&scene, &settings());
    let compact = compact.cohorts[0]
        .clone()
        .with_lives(order.iter().map(|&g| Life { birth: 0, death: 8 - (g % 3) as u32 }).collect());
    let error_of =
        |original: &DynamicGaussians| AttributeErrors::of(&compact, &mut &*original, &order).unwrap().by_name()[0].1;
    let errors = error_of(&scene);
    let mut other = scene.clone();
    for g in (0..9).filter(|g| g % 3 == 2) {
        other.means_mut(6)[g] = [100.0; 3];
        other.means_mut(7)[g] = [100.0; 3];
    }
    assert_eq!(error_of(&other), errors, "nothing lives there");
    other.means_mut(5)[2] = [100.0; 3];
    assert!(error_of(&other) > 50.0);
}

#[test]
fn errors_become_as_small_as_is_asked() {
    let scene = scene(60, 14, &Layout::with_harmonics(1));
    let layout = scene.layout();
    for (attribute, goal) in layout.attributes().zip([1e-3, 2e-3, 1e-3, 1e-3, 1e-3, 1e-3]) {
        let mut settings = settings();
        let mut errors = Vec::new();
        for _ in 0..6 {
            let error = f64::from(compress(&scene, &settings).0.declared_errors[attribute.index()].1);
            errors.push(error);
            if error <= goal {
                break;
            }
            settings = settings.with_smaller_errors(&[(layout.column(attribute), 1.25 * (error / goal) as f32)]);
        }
        assert!(errors.len() > 1 && errors[errors.len() - 1] <= goal, "{attribute:?}: {errors:?}");
    }
}

#[test]
fn parts_of_a_sequence_declare_theirs() {
    let mut source = scene(30, 6, &Layout::base());
    for t in 0..6 {
        source.colors_mut(t)[3] = [0.25 + 0.01 * t as f32, 0.5, 0.75];
    }
    let (mut errors, mut cohorts) = (AttributeErrors::none(source.layout()), Vec::new());
    for part in FollowedParts::new(&mut &source, 4) {
        let part = part.unwrap();
        let bits = BitMap::uniform(part.lives.len(), 14, 8);
        let (compact, order) =
            compress_ordered(&part.scene, &bits, None, SceneInfo::of(&part.scene), &settings()).unwrap();
        let compact = CompactScene { start: part.start as u32, ..compact.with_lives(part.lives.select(&order)) };
        errors.extend(&AttributeErrors::of(&compact, &mut &part.scene, &order).unwrap());
        cohorts.push(compact);
    }
    let info = SceneInfo {
        num_gaussians: cohorts.iter().map(|cohort| cohort.info.num_gaussians).sum(),
        num_timesteps: 6,
        ..cohorts[0].info.clone()
    };
    let compact = CompactFile { info, cohorts, declared_errors: errors.declared(), light: Light::default() };
    let file = CompactFile::decode(&compact.encode(2, &[]).unwrap(), &DecodeLimits::default()).unwrap();
    assert_eq!(file, compact);
    // Every compressed mean has a decoded one within the declared error.
    for t in 0..6 {
        let decoded = file.at(t);
        assert_eq!(decoded.num_gaussians(), 30);
        for mean in source.means(t) {
            let distance = |p: &[f32; 3]| (0..3).map(|i| f64::from(p[i] - mean[i]).powi(2)).sum::<f64>().sqrt();
            let nearest = decoded.means().iter().map(distance).fold(f64::MAX, f64::min);
            assert!(nearest <= f64::from(file.declared_errors[0].1), "timestep {t}: {nearest}");
        }
    }
}

#[test]
fn what_cannot_be_declared_is_refused() {
    let declare = |errors: &[(String, f32)]| {
        let info = SceneInfo { num_timesteps: 1, downscale: 1, ..SceneInfo::default() };
        FileWriter::declaring(&mut Cursor::new(Vec::new()), &info, errors, &[], 0).map(drop)
    };
    declare(&[("means".into(), 0.0)]).unwrap();
    for wrong in [-0.5, f32::NAN, f32::INFINITY] {
        let error = declare(&[("means".into(), wrong)]).unwrap_err();
        assert!(matches!(error, CompressError::Value { what: "declared error", .. }), "{error}");
    }
    let error = declare(&vec![("means".into(), 1.0); 256]).unwrap_err();
    assert!(matches!(error, CompressError::Count { found: 256, expected: 255, .. }), "{error}");
}

#[test]
fn settings_for_smaller_errors_leave_other_attributes_alone() {
    let before = CompressSettings::default();
    let column = tcgs_core::Column::like(Attribute::Mean);
    let after = before.clone().with_smaller_errors(&[(&column, 8.0)]);
    assert_eq!(after.position_fineness, 8.0 * before.position_fineness);
    assert_eq!((after.coarser, after.covers_outliers), (before.coarser, [true, false, false, false, false]));
    assert_eq!(after.max_mse[1..], before.max_mse[1..]);
    // Attributes that share an entry of the settings are refined together, once.
    let layout = Layout::with_harmonics(2);
    let shared: Vec<_> = layout.columns()[4..].iter().zip([4.0, 16.0, 2.0]).collect();
    let after = before.clone().with_smaller_errors(&shared);
    assert_eq!((after.coarser[4], after.harmonic_error), (before.coarser[4] - 4.0, 0.0));
}

/// Errors that are measured while the cohorts are written replace those declared first.
#[test]
fn errors_may_be_declared_once_all_cohorts_are_written() {
    let scene = scene(20, 6, &Layout::base());
    let (compact, _) = compress(&scene, &settings());
    let errors = compact.declared_errors.clone();
    let unknown: Vec<(String, f32)> = errors.iter().map(|(name, _)| (name.clone(), 0.0)).collect();
    let mut file = Cursor::new(Vec::new());
    let mut writer = FileWriter::declaring(&mut file, &compact.info, &unknown, &[], 1).unwrap();
    writer.add(&compact.cohorts[0]).unwrap();
    let others = [&errors[..4], &[("glow".to_owned(), 1.0)]].concat();
    for wrong in [&errors[1..], &others, &[(errors[0].0.clone(), f32::NAN)]] {
        assert!(writer.declare(wrong).is_err(), "{wrong:?}");
    }
    writer.declare(&errors).unwrap();
    writer.finish().unwrap();
    assert!(file.into_inner() == compact.encode(2, &[]).unwrap());
}
