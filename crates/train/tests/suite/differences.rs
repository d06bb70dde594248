//! Motion priors against central differences, in f64.

use tcgs_core::normalize;
use tcgs_train::engine::cpu::{MotionPrior, PriorGrads};
use tcgs_train::{LossTerms, Neighbors, WeightConfig};

type State = (Vec<[f64; 3]>, Vec<[f64; 4]>, Vec<[f64; 3]>);

fn random(seed: &mut u64) -> f64 {
    *seed = seed.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
    (*seed >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
}

fn state(seed: u64) -> State {
    let mut s = seed;
    let mut row = |scale: f64| -> [f64; 4] { std::array::from_fn(|_| scale * random(&mut s)) };
    let n = 14;
    let means = (0..n).map(|_| row(0.4)).map(|r| [r[0], r[1], r[2]]).collect();
    let quats = (0..n).map(|_| row(1.0)).map(|r| [r[0] + 1.0, r[1], r[2], r[3]]).collect();
    let colors = (0..n).map(|_| row(1.0)).map(|r| [r[0], r[1], r[2]]).collect();
    (means, quats, colors)
}

fn total(l: &LossTerms, w: &WeightConfig) -> f64 {
    let pairs = [
        (l.rigid, w.rigid),
        (l.rot, w.rot),
        (l.iso, w.iso),
        (l.floor, w.floor),
        (l.background, w.background),
        (l.soft_color, w.soft_color),
        (l.stillness, w.stillness),
    ];
    pairs.iter().map(|&(value, weight)| value * f64::from(weight)).sum()
}

#[test]
fn every_prior_matches_central_differences() {
    let foreground: Vec<bool> = (0..14).map(|i| i % 3 != 2).collect();
    let members: Vec<u32> = (0..14).filter(|&i| foreground[i as usize]).collect();
    let (per_node, f) = (3, members.len());
    let indices = (0..f * per_node).map(|e| ((e / per_node + e % per_node + 1) % f) as u32).collect();
    let weights = (0..f * per_node).map(|e| 0.2 + 0.05 * (e % 7) as f64).collect();
    let distances = (0..f * per_node).map(|e| 0.1 + 0.01 * (e % 5) as f64).collect();
    let neighbors = Neighbors::from_edges(members, per_node, indices, weights, distances);
    let (first, before, now) = (state(1), state(2), state(3));
    let stillness: Vec<f64> = (0..14).map(|i| f64::from(i) / 13.0).collect();
    let prior = MotionPrior::new(neighbors.into(), &foreground, &first.0, &first.1, &before.0, &before.1, &before.2)
        .with_stillness(&stillness, &before.0, &before.1);

    let all = WeightConfig {
        rigid: 4.0,
        rot: 4.0,
        iso: 2.0,
        floor: 2.0,
        background: 20.0,
        soft_color: 0.5,
        stillness: 0.3,
        ..WeightConfig::NONE
    };
    let one = |field: usize| {
        let on = |i: usize, w: f32| if i == field { w } else { 0.0 };
        WeightConfig {
            rigid: on(0, all.rigid),
            rot: on(1, all.rot),
            iso: on(2, all.iso),
            floor: on(3, all.floor),
            background: on(4, all.background),
            soft_color: on(5, all.soft_color),
            stillness: on(6, all.stillness),
            ..WeightConfig::NONE
        }
    };
    for field in 0..7 {
        let weights = one(field);
        let evaluate = |s: &State| {
            let n = s.0.len();
            let (mut v_means, mut v_quats, mut v_colors) = (vec![[0.0; 3]; n], vec![[0.0; 4]; n], vec![[0.0; 3]; n]);
            let grads = PriorGrads { v_means: &mut v_means, v_quats: &mut v_quats, v_colors: &mut v_colors };
            let losses = prior.losses(&s.0, &s.1, &s.2, &weights, grads);
            (total(&losses, &weights), v_means, v_quats, v_colors)
        };
        let (value, v_means, v_quats, v_colors) = evaluate(&now);
        assert!(value > 0.0, "loss {field} is inactive");
        let check = |found: f64, place: &str, moved: &dyn Fn(f64) -> State| {
            let h = 1e-6;
            let difference = (evaluate(&moved(h)).0 - evaluate(&moved(-h)).0) / (2.0 * h);
            assert!(
                (difference - found).abs() < 1e-6 * difference.abs().max(1.0),
                "loss {field}, {place}: {difference} against {found}"
            );
        };
        for i in 0..now.0.len() {
            for d in 0..3 {
                check(v_means[i][d], "means", &|h| {
                    let mut s = now.clone();
                    s.0[i][d] += h;
                    s
                });
                check(v_colors[i][d], "colors", &|h| {
                    let mut s = now.clone();
                    s.2[i][d] += h;
                    s
                });
            }
            for d in 0..4 {
                check(v_quats[i][d], "quats", &|h| {
                    let mut s = now.clone();
                    s.1[i][d] += h;
                    s
                });
            }
        }
    }
}

#[test]
fn empty_sets_contribute_nothing() {
    let s = state(5);
    for foreground in [vec![true; 14], vec![false; 14]] {
        let means: Vec<[f32; 3]> = s.0.iter().map(|m| m.map(|x| x as f32)).collect();
        let quats: Vec<[f32; 4]> = s.1.iter().map(|q| normalize(q.map(|x| x as f32))).collect();
        let colors: Vec<[f32; 3]> = s.2.iter().map(|c| c.map(|x| x as f32)).collect();
        let neighbors = Neighbors::new(&means, &foreground);
        let prior = MotionPrior::new(neighbors.into(), &foreground, &means, &quats, &means, &quats, &colors);
        let weights = WeightConfig {
            rigid: 4.0,
            rot: 4.0,
            iso: 2.0,
            floor: 2.0,
            background: 20.0,
            soft_color: 0.5,
            ..WeightConfig::NONE
        };
        let (mut v_means, mut v_quats, mut v_colors) = (vec![[0.0; 3]; 14], vec![[0.0; 4]; 14], vec![[0.0; 3]; 14]);
        let grads = PriorGrads { v_means: &mut v_means, v_quats: &mut v_quats, v_colors: &mut v_colors };
        let losses = prior.losses(&means, &quats, &colors, &weights, grads);
        assert!(total(&losses, &weights).is_finite());
        assert!(v_means.as_flattened().iter().chain(v_quats.as_flattened()).all(|v| v.is_finite()));
        assert_eq!(losses.background, 0.0);
    }
}
