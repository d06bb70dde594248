//! Cubic curves through keypoints (Catmull-Rom), compared with straight lines.

/// Algorithm 1 with a cubic curve between keypoints: their indices, and the squared error summed over time.
///
/// - `max_mse`: mean squared error at which to stop
pub fn select(track: &[f32], max_mse: f32) -> (Vec<usize>, f64) {
    let mut indices = vec![0, track.len() - 1];
    loop {
        let curve = curve(track, &indices);
        let errors: Vec<f64> = track.iter().zip(&curve).map(|(&x, y)| (f64::from(x) - y).powi(2)).collect();
        let sum: f64 = errors.iter().sum();
        if sum <= f64::from(max_mse) * track.len() as f64 || indices.len() == track.len() {
            return (indices, sum);
        }
        let new = (0..track.len()).filter(|i| !indices.contains(i));
        let worst = new.max_by(|&a, &b| errors[a].total_cmp(&errors[b]).then(b.cmp(&a)));
        let worst = worst.expect("some are no keypoints yet");
        indices.insert(indices.partition_point(|&i| i < worst), worst);
    }
}

/// Cubic Hermite curves. The tangent at a keypoint is the slope between its neighbours, or that of the chord at the
/// ends.
fn curve(track: &[f32], indices: &[usize]) -> Vec<f64> {
    let value = |k: usize| f64::from(track[indices[k]]);
    let slope = |k: usize| {
        let (before, after) = (k.saturating_sub(1), (k + 1).min(indices.len() - 1));
        (value(after) - value(before)) / (indices[after] - indices[before]) as f64
    };
    let mut curve = vec![value(0)];
    for k in 0..indices.len() - 1 {
        let length = (indices[k + 1] - indices[k]) as f64;
        curve.extend((indices[k] + 1..=indices[k + 1]).map(|i| {
            let u = (i - indices[k]) as f64 / length;
            let (u2, u3) = (u * u, u * u * u);
            (2.0 * u3 - 3.0 * u2 + 1.0) * value(k)
                + (u3 - 2.0 * u2 + u) * length * slope(k)
                + (3.0 * u2 - 2.0 * u3) * value(k + 1)
                + (u3 - u2) * length * slope(k + 1)
        }));
    }
    curve
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn curves_pass_keypoints_and_follow_parabolas_between_equal_distances() {
        let parabola: Vec<f32> = (0..13).map(|i| (i * i) as f32).collect();
        let found = curve(&parabola, &[0, 3, 6, 9, 12]);
        for i in 3..=9 {
            assert!((found[i] - f64::from(parabola[i])).abs() < 1e-9, "{i}: {}", found[i]);
        }
        assert_eq!((found[0], found[12]), (0.0, 144.0));
    }

    #[test]
    fn smooth_motion_takes_fewer_keypoints_than_chords() {
        let wave: Vec<f32> = (0..60).map(|i| (i as f32 * 0.1).sin()).collect();
        let (indices, error) = select(&wave, 1e-5);
        assert!(error <= 1e-5 * 60.0);
        assert!(indices.len() < tcgs_codec::select_keypoints(&wave, 60, 1e-5).unwrap().len());
    }
}
