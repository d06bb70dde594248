//! Keypoint selection against the authors' results, and properties of every track.

use proptest::prelude::*;
use std::io::Write;
use tcgs_codec::{interpolate, select_keypoints};

/// Algorithm 1 as printed: the whole track is interpolated again for every keypoint.
fn naive(track: &[f32], max_keypoints: usize, max_mse: f32) -> Vec<usize> {
    if track.len() < 2 {
        return (0..track.len()).collect();
    }
    let mut keypoints = vec![0, track.len() - 1];
    loop {
        let errors: Vec<f64> = (0..track.len())
            .map(|i| {
                if keypoints.contains(&i) {
                    return 0.0;
                }
                let before = *keypoints.iter().rev().find(|&&k| k < i).expect("the first is kept");
                let after = *keypoints.iter().find(|&&k| k > i).expect("the last is kept");
                let [a, b] = [before, after].map(|k| f64::from(track[k]));
                let slope = (b - a) / (after - before) as f64;
                (f64::from(track[i]) - (a + slope * (i - before) as f64)).powi(2)
            })
            .collect();
        // Eight interleaved partial sums, then the rest: the documented order.
        let whole = errors.len() / 8 * 8;
        let mut sum = 0.0;
        for lane in 0..8 {
            sum += errors[..whole].iter().skip(lane).step_by(8).sum::<f64>();
        }
        for error in &errors[whole..] {
            sum += error;
        }
        if sum / track.len() as f64 <= f64::from(max_mse) || keypoints.len() >= max_keypoints {
            return keypoints;
        }
        let mut worst = 0;
        for i in 0..errors.len() {
            if errors[i] > errors[worst] {
                worst = i;
            }
        }
        keypoints.push(worst);
        keypoints.sort_unstable();
    }
}

fn mse(track: &[f32], keypoints: &[usize]) -> f64 {
    let times: Vec<u16> = keypoints.iter().map(|&i| i as u16).collect();
    let values: Vec<f32> = keypoints.iter().map(|&i| track[i]).collect();
    let squared = |i: usize| (f64::from(track[i]) - f64::from(interpolate(&times, &values, i))).powi(2);
    (0..track.len()).map(squared).sum::<f64>() / track.len() as f64
}

/// Noise, a random walk, or repeated values with tied errors.
fn tracks() -> impl Strategy<Value = Vec<f32>> {
    prop_oneof![
        prop::collection::vec(-10.0_f32..10.0, 0..80),
        prop::collection::vec(-1.0_f32..1.0, 0..200).prop_map(|steps| {
            steps
                .iter()
                .scan(0.0, |x, step| {
                    *x += step;
                    Some(*x)
                })
                .collect()
        }),
        prop::collection::vec((-2_i8..3).prop_map(f32::from), 0..60),
    ]
}

fn tolerances() -> impl Strategy<Value = f32> {
    prop_oneof![Just(0.0), Just(f32::INFINITY), (-8.0_f32..1.5).prop_map(|e| 10.0_f32.powf(e))]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    #[test]
    fn equals_the_naive_version(track in tracks(), max_keypoints in 0_usize..100, max_mse in tolerances()) {
        prop_assert_eq!(select_keypoints(&track, max_keypoints, max_mse).unwrap(), naive(&track, max_keypoints, max_mse));
    }

    #[test]
    fn keeps_the_contract(track in tracks(), max_keypoints in 0_usize..100, max_mse in tolerances()) {
        let keypoints = select_keypoints(&track, max_keypoints, max_mse).unwrap();
        let max_keypoints = max_keypoints.max(2);
        prop_assert!(keypoints.is_sorted_by(|a, b| a < b));
        prop_assert!(keypoints.len() <= max_keypoints);
        prop_assert_eq!(keypoints.first().copied(), (!track.is_empty()).then_some(0));
        prop_assert_eq!(keypoints.last().copied(), track.len().checked_sub(1));
        if !track.is_empty() && keypoints.len() < max_keypoints {
            // Interpolation in f32 adds rounding.
            let rounding = 1e-11;
            prop_assert!(mse(&track, &keypoints) <= f64::from(max_mse) * (1.0 + 1e-5) + rounding);
        }
        let times: Vec<u16> = keypoints.iter().map(|&i| i as u16).collect();
        let values: Vec<f32> = keypoints.iter().map(|&i| track[i]).collect();
        for &i in &keypoints {
            prop_assert_eq!(interpolate(&times, &values, i), track[i]);
        }
    }

    #[test]
    fn a_straight_line_has_two(start in -100.0_f32..100.0, slope in -10.0_f32..10.0, length in 2_usize..300) {
        let track: Vec<f32> = (0..length).map(|i| start + slope * i as f32).collect();
        let largest = track.iter().fold(0.0_f32, |a, x| a.max(x.abs()));
        // Each of the two operations rounds by at most half a unit in the last place.
        let rounding = (2.0 * largest * f32::EPSILON).powi(2).max(1e-30);
        prop_assert_eq!(select_keypoints(&track, 1000, rounding).unwrap(), [0, length - 1]);
    }

    #[test]
    fn powers_of_two_do_not_matter(track in tracks(), max_mse in -6.0_f32..1.0, power in -20_i32..21) {
        let max_mse = 10.0_f32.powf(max_mse);
        let scaled: Vec<f32> = track.iter().map(|x| x * 2.0_f32.powi(power)).collect();
        prop_assert_eq!(
            select_keypoints(&track, 50, max_mse).unwrap(),
            select_keypoints(&scaled, 50, max_mse * 4.0_f32.powi(power)).unwrap()
        );
    }
}

#[test]
fn the_authors_keypoints_are_reproduced() {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/golden/keypoints");
    for max_keypoints in 3..=6 {
        let path = format!("{folder}/max_keypoints_{max_keypoints}.json");
        let Ok(text) = std::fs::read_to_string(&path) else {
            assert!(std::env::var_os("REQUIRE_GOLDEN").is_none(), "{path} is missing");
            // Written past the test harness's capture, so that a skip is visible.
            let _ = writeln!(std::io::stderr(), "skipped: {path} is missing");
            return;
        };
        let golden: serde_json::Value = serde_json::from_str(&text).unwrap();
        let tracks: Vec<Vec<f32>> = serde_json::from_value(golden["function_values"].clone()).unwrap();
        let expected: Vec<Vec<usize>> = serde_json::from_value(golden["optimized_keypoints_idx"].clone()).unwrap();
        let found: Vec<Vec<usize>> = tracks.iter().map(|t| select_keypoints(t, max_keypoints, 1e-4).unwrap()).collect();
        assert_eq!(found, expected, "{path}");
        let error: f64 = tracks.iter().zip(&found).map(|(t, k)| mse(t, k)).sum::<f64>() / 3.0;
        let reported = golden["optimized_error"].as_f64().unwrap();
        assert!((error - reported).abs() < 1e-6 * reported, "{error} against {reported}");
    }
}
