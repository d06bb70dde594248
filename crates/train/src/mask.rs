//! Learned masks, paper Eq. 1 to 6.

use tcgs_core::{Lives, Real, sigmoid, sigmoid_vjp};

/// Binary mask of one Gaussian, paper Eq. 1.
///
/// - `logit`: `m_{n,t}`, unbounded
/// - `threshold`: `ε`, in `[0, 1)`
/// - returns: `M_n`, exactly 0 or 1
///
/// ```
/// use tcgs_train::mask;
/// assert_eq!((mask(-4.0, 0.01), mask(-5.0, 0.01)), (1.0, 0.0)); // σ(−4) = 0.018, σ(−5) = 0.0067
/// ```
pub fn mask<R: Real>(logit: R, threshold: R) -> R {
    if sigmoid(logit) > threshold { R::one() } else { R::zero() }
}

/// VJP of [`mask`]: `∂L/∂logit` from `v_mask = ∂L/∂M`.
///
/// Straight-through: differentiates `σ(logit)`, not the step, so the threshold does not appear.
pub fn mask_vjp<R: Real>(logit: R, v_mask: R) -> R {
    sigmoid_vjp(sigmoid(logit), v_mask)
}

/// `L_mask`, paper Eq. 4, and its gradient.
///
/// - `logits`: `[N]`
/// - `accumulate(n, v)`: is told `v = ∂L_mask/∂m_n` of every Gaussian, in order
/// - returns: the mean of `σ(m_n)`; 0 of none
///
/// # Departure
/// A mean where the paper prints a sum: its authors' code takes the mean, and with the printed
/// weight a sum over 10⁵ Gaussians would drown every other term.
pub fn mask_loss<R: Real>(logits: &[R], mut accumulate: impl FnMut(usize, R)) -> f64 {
    let share = R::one() / R::of(logits.len().max(1) as f64);
    let mut sum = 0.0;
    for (n, &logit) in logits.iter().enumerate() {
        let value = sigmoid(logit);
        sum += value.to_f64().unwrap_or(f64::NAN);
        accumulate(n, sigmoid_vjp(value, share));
    }
    sum / logits.len().max(1) as f64
}

/// `L_mc`, paper Eq. 5, and its gradient; the timestep before has no gradient (stop-gradient).
///
/// - `logits`, `previous`: `[N]`, at this timestep and the one before
/// - `accumulate(n, v)`: is told `v = ∂L_mc/∂m_n` where it is not zero, in order
/// - returns: the mean of `|m_n − previous m_n|`; 0 of none
///
/// # Departure
/// A mean where the paper prints a sum, for the reason of [`mask_loss`].
///
/// # Panics
/// If the two differ in length.
pub fn mask_consistency_loss<R: Real>(logits: &[R], previous: &[R], mut accumulate: impl FnMut(usize, R)) -> f64 {
    assert_eq!(logits.len(), previous.len(), "mask logits of two timesteps");
    let share = R::one() / R::of(logits.len().max(1) as f64);
    let mut sum = 0.0;
    for (n, (&logit, &before)) in logits.iter().zip(previous).enumerate() {
        let difference = logit - before;
        sum += difference.abs().to_f64().unwrap_or(f64::NAN);
        if difference != R::zero() {
            accumulate(n, share * difference.signum());
        }
    }
    sum / logits.len().max(1) as f64
}

/// Which Gaussians of a checkpoint are not drawn: those whose mask (paper Eq. 1) is 0.
///
/// - `mask_logits`: `[N]`
/// - `threshold`: `ε`, in `[0, 1)`
/// - returns: `[N]`
pub fn masked_out(mask_logits: &[f32], threshold: f32) -> Vec<bool> {
    mask_logits.iter().map(|&m| mask(m, threshold) == 0.0).collect()
}

/// Mean over time of each Gaussian's mask value `σ(m_{n,t})`, paper Eq. 6. The mean runs from its birth to the last
/// timestep; after its death its last value counts.
///
/// - `mask_logits`: for every timestep those of the Gaussians that live; taken one after another, so that only the last
///   has to be in memory
/// - `lives`: the lifetimes; none if all `N` live at all timesteps
/// - returns: `[N]`, in (0, 1); 0 for a Gaussian that is not born yet
///
/// # Panics
/// If a timestep has a different number of Gaussians than live then.
///
/// ```
/// assert_eq!(tcgs_train::mean_masks([vec![0.0, 40.0], vec![0.0, 40.0]], None), [0.5, 1.0]);
/// ```
pub fn mean_masks<L: AsRef<[f32]>>(mask_logits: impl IntoIterator<Item = L>, lives: Option<&Lives>) -> Vec<f32> {
    // Value, sum of values, and number of timesteps.
    let mut all = vec![(0.0, 0.0, 0); lives.map_or(0, |lives| lives.len())];
    for (timestep, logits) in mask_logits.into_iter().enumerate() {
        let logits = logits.as_ref();
        if lives.is_none() && timestep == 0 {
            all.resize(logits.len(), (0.0, 0.0, 0));
        }
        let living = lives.map_or_else(|| (0..all.len()).collect(), |lives| lives.living(timestep));
        assert_eq!(logits.len(), living.len(), "mask logits of timestep {timestep} against those that live");
        for (&id, &logit) in living.iter().zip(logits) {
            all[id].0 = sigmoid(logit);
        }
        let num_born = lives.map_or(all.len(), |lives| lives.partition_point(|life| life.birth as usize <= timestep));
        for (value, sum, num_timesteps) in &mut all[..num_born] {
            *sum += *value;
            *num_timesteps += 1;
        }
    }
    all.into_iter().map(|(_, sum, num_timesteps)| sum / num_timesteps.max(1) as f32).collect()
}

#[cfg(test)]
mod tests {
    use tcgs_core::Life;

    use super::*;

    #[test]
    fn the_mask_is_binary_and_its_gradient_that_of_the_sigmoid() {
        assert_eq!((mask(-4.0, 0.01), mask(-5.0, 0.01)), (1.0, 0.0)); // σ(−4) = 0.018, σ(−5) = 0.0067
        let (m, h) = (-5.0_f64, 1e-6);
        let surrogate = (sigmoid(m + h) - sigmoid(m - h)) / (2.0 * h);
        assert!((mask_vjp(m, 3.0) - 3.0 * surrogate).abs() < 1e-9);
    }

    #[test]
    fn a_mean_begins_with_the_birth_and_goes_on_after_the_death() {
        let lives = Lives::from([Life::since(0), Life { birth: 0, death: 2 }, Life::since(1)]);
        let logits = [vec![0.0, 40.0], vec![0.0, -40.0, 0.0], vec![0.0, 40.0], vec![40.0, 0.0]];
        let means = mean_masks(logits, Some(&lives));
        assert_eq!(means, [2.5 / 4.0, 0.25, 2.0 / 3.0]);
    }

    #[test]
    fn losses_match_central_differences() {
        let logits = [1.0_f64, -2.0, 0.3, 4.0];
        let previous = [0.5, -2.5, 0.9, 4.0];
        let mut v_mask = [0.0; 4];
        let mut v_consistency = [0.0; 4];
        let value = mask_loss(&logits, |n, v| v_mask[n] = v);
        mask_consistency_loss(&logits, &previous, |n, v| v_consistency[n] = v);
        assert!((value - logits.iter().map(|&m| sigmoid(m)).sum::<f64>() / 4.0).abs() < 1e-12);
        for n in 0..3 {
            let at = |d: f64, loss: &dyn Fn(&[f64]) -> f64| {
                let mut moved = logits;
                moved[n] += d;
                loss(&moved)
            };
            let difference = |loss: &dyn Fn(&[f64]) -> f64| (at(1e-6, loss) - at(-1e-6, loss)) / 2e-6;
            assert!((difference(&|m| mask_loss(m, |_, _| ())) - v_mask[n]).abs() < 1e-9);
            assert!((difference(&|m| mask_consistency_loss(m, &previous, |_, _| ())) - v_consistency[n]).abs() < 1e-9);
        }
        assert_eq!(v_consistency[3], 0.0);
    }
}
