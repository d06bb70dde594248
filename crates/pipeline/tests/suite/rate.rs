//! Before a refinement, quality and Gaussians are chosen by training images.

use crate::support::{files, open};
use tcgs_capture::Split;
use tcgs_pipeline::{
    Allowance, Backend, CompressOptions, Judge, JudgeImages, OpenScene, PrunedScene, RefineBudget, RefineOptions,
    Refined, Unobserved, refine,
};
use tcgs_train::RefineConfig;

/// As many as the whole allowance takes.
const ITERATIONS: usize = 1000;

/// Refined at a rate of 0, so that only the choice changes the file.
fn refined(scene: &OpenScene, options: &CompressOptions, allowance: Allowance) -> Refined {
    let pruned = PrunedScene::new(scene, options).unwrap();
    let (capture, budget) = (files().join("capture"), RefineBudget::Iterations(ITERATIONS));
    let config = RefineConfig { rate: 0.0, ..RefineConfig::default() };
    let refining = RefineOptions { capture, budget, config, allowance };
    refine(scene, &pruned, &options.keypoints, &refining, &Backend::Cpu, &mut Unobserved).unwrap()
}

/// Mean squared error of training images relative to that of another file.
fn growth(scene: &OpenScene, refined: &Refined, other: &Refined) -> f64 {
    let images = JudgeImages { capture: Some(files().join("capture")), split: Split::Train, frames: None };
    let judge = Judge::new(scene, &images, Backend::Cpu.renderer()).unwrap();
    let [psnr, of_other] = [refined, other].map(|refined| judge.psnr(&refined.compact).unwrap());
    10.0_f64.powf(0.1 * (of_other - psnr)) - 1.0
}

#[test]
fn rounding_takes_the_error_that_is_allowed() {
    let scene = open(&files().join("run"));
    let options = CompressOptions::default();
    let at = |rounding| refined(&scene, &options, Allowance { rounding, removal: 0.0 });
    let finest = at(Some(-0.5));
    let allowed = [0.02, 0.15, 1.0].map(|share| (share, at(Some(share))));
    let coarsest = at(Some(1e6));
    // Four cameras are sparse views, which have at most quality 0.
    assert_eq!((finest.quality, coarsest.quality, at(None).quality), (Some(0.0), Some(-2.0), None));
    for pair in [&allowed[0], &allowed[1], &allowed[2]].windows(2) {
        assert!(pair[0].1.quality >= pair[1].1.quality, "{:?} {:?}", pair[0].1.quality, pair[1].1.quality);
        assert!(pair[0].1.file.len() >= pair[1].1.file.len());
    }
    for (share, chosen) in &allowed {
        let grown = growth(&scene, chosen, &finest);
        // Relative to floats, from which the finest codes hardly differ. Images have other weights than their errors.
        assert!(grown < f64::from(*share) + 0.05, "{grown} for {share}, quality {:?}", chosen.quality);
    }
    // The training is so short that coarse codes need not have a larger error.
    assert!(coarsest.file.len() < finest.file.len());
}

#[test]
fn removal_takes_the_error_that_is_allowed() {
    let scene = open(&files().join("run"));
    let options = CompressOptions::default();
    let without = |removal| refined(&scene, &options, Allowance { rounding: None, removal });
    let all = without(0.0);
    let count = all.compact.num_identities();
    // The error of this short training falls when some Gaussians go.
    let counts = [0.0, 0.02, 1e6].map(|share| without(share).compact.num_identities());
    assert!(counts[0] == count && count > counts[1] && counts[1] >= counts[2], "{counts:?} of {count}");
    assert!(5 * counts[2] >= 2 * count, "{counts:?}: at most three of five of {count} go");
    let some = without(0.02);
    assert!(some.file.len() < all.file.len() && growth(&scene, &some, &all) < 0.07);
    assert_eq!(refined(&scene, &options, Allowance::NONE).file, all.file);
}
