//! Properties of every quantizer.

use proptest::prelude::*;
use tcgs_codec::Quantizer;

fn values() -> impl Strategy<Value = Vec<f32>> {
    prop_oneof![
        prop::collection::vec(-3.0_f32..5.0, 1..200),
        prop::collection::vec((-6.0_f32..6.0).prop_map(|e| 10.0_f32.powf(e)), 1..50),
        (-1e6_f32..1e6, prop::collection::vec(-1.0_f32..1.0, 1..50))
            .prop_map(|(center, around)| around.iter().map(|x| center + x).collect()),
    ]
}

fn bounds(values: &[f32]) -> (f32, f32) {
    values.iter().fold((f32::MAX, f32::MIN), |(a, b), &x| (a.min(x), b.max(x)))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(500))]

    #[test]
    fn covering_errs_by_half_a_step(values in values(), bits in 1_u8..17) {
        let (min, max) = bounds(&values);
        let quantizer = Quantizer::covering(min, max, bits).unwrap();
        for &x in &values {
            let error = (f64::from(x) - f64::from(quantizer.dequantize(quantizer.quantize(x)))).abs();
            // The offset and the result are rounded to f32.
            let rounding = 2.0 * f64::from(min.abs().max(max.abs()) * f32::EPSILON);
            prop_assert!(error <= 0.5 * f64::from(quantizer.step) + rounding, "{} of {:?}", x, quantizer);
        }
    }

    #[test]
    fn codes_stay_in_range_come_back_and_keep_the_order(values in values(), bits in 1_u8..17, x in -1e7_f32..1e7, y in -1e7_f32..1e7) {
        let (min, max) = bounds(&values);
        for quantizer in [Quantizer::covering(min, max, bits).unwrap(), Quantizer::fit(&values, bits).unwrap()] {
            prop_assert!(quantizer.problem().is_none());
            let range = quantizer.min_code()..=quantizer.max_code();
            prop_assert_eq!(range.clone().count(), 1 << bits);
            prop_assert!(range.contains(&quantizer.quantize(x)));
            prop_assert!((quantizer.quantize(x) <= quantizer.quantize(y)) == (x <= y) || quantizer.quantize(x) == quantizer.quantize(y));
            for code in range {
                prop_assert_eq!(quantizer.quantize(quantizer.dequantize(code)), code, "{:?}", quantizer);
            }
        }
    }

    #[test]
    fn fitting_is_no_worse_than_covering(values in values(), bits in 1_u8..17) {
        let (min, max) = bounds(&values);
        let covering = Quantizer::covering(min, max, bits).unwrap().squared_error(&values);
        prop_assert!(Quantizer::fit(&values, bits).unwrap().squared_error(&values) <= covering);
    }

    #[test]
    fn a_constant_is_exact(value in prop::num::f32::NORMAL | prop::num::f32::ZERO, bits in 1_u8..17) {
        prop_assume!(value.abs() < 1e30);
        let quantizer = Quantizer::fit(&[value; 5], bits).unwrap();
        prop_assert_eq!(quantizer.dequantize(quantizer.quantize(value)), value);
    }
}
