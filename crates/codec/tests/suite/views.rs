//! Cameras in files: written cameras are read back, and no bytes make the reader panic.

use proptest::prelude::*;
use tcgs_codec::{FileCamera, VIEWS, read_views, write_views};
use tcgs_core::Camera;

fn read(bytes: &[u8]) -> Vec<FileCamera> {
    read_views(&[(VIEWS.into(), bytes.to_vec())])
}

/// JSON that resembles views, with numbers that no camera has.
fn nearly_views() -> impl Strategy<Value = String> {
    let number = prop_oneof![
        Just("0".to_owned()),
        Just("-1".to_owned()),
        Just("1e308".to_owned()),
        Just("-1e-320".to_owned()),
        Just("18446744073709551616".to_owned()),
        Just("null".to_owned()),
        (-2.0..2.0_f64).prop_map(|x| x.to_string()),
        any::<u32>().prop_map(|x| x.to_string()),
    ];
    let list = |n: usize| prop::collection::vec(number.clone(), n).prop_map(|all| format!("[{}]", all.join(",")));
    let view = (number.clone(), number.clone(), list(2), list(2), list(3), list(4)).prop_map(
        |(width, height, focal, principal, position, rotation)| {
            format!(
                r#"{{"name":"a","width":{width},"height":{height},"focal":{focal},"principal":{principal},"position":{position},"rotation":{rotation}}}"#
            )
        },
    );
    prop::collection::vec(view, 0..4).prop_map(|views| format!(r#"{{"views":[{}]}}"#, views.join(",")))
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn what_is_written_is_read(
        eye in prop::array::uniform3(-50.0..50.0_f64),
        target in prop::array::uniform3(60.0..90.0_f64),
        focal in 1.0..5000.0_f64,
        width in 1_usize..4000,
        height in 1_usize..4000,
    ) {
        let camera = Camera::look_at(eye, target, [0.0, -1.0, 0.0], focal, width, height);
        let found = read(&write_views(&[FileCamera { name: "7".into(), camera: camera.clone() }]));
        prop_assert_eq!(found.len(), 1);
        let found = &found[0].camera;
        prop_assert_eq!((found.width, found.height), (width, height));
        for i in 0..3 {
            prop_assert!((found.center()[i] - camera.center()[i]).abs() < 1e-4);
            prop_assert!((found.forward()[i] - camera.forward()[i]).abs() < 1e-4);
        }
        for i in 0..2 {
            prop_assert!((found.focal[i] - camera.focal[i]).abs() < 0.0051);
        }
        // A second rounding may change a last digit, and no more.
        prop_assert_eq!(read(&write_views(&[FileCamera { name: "7".into(), camera: found.clone() }])).len(), 1);
    }

    #[test]
    fn any_bytes_are_read_without_a_panic(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
        read(&bytes);
    }

    #[test]
    fn what_is_read_is_a_camera(json in nearly_views()) {
        for view in read(json.as_bytes()) {
            let numbers = [view.camera.camera_from_world.as_flattened(), &view.camera.focal, &view.camera.principal];
            prop_assert!(numbers.concat().iter().all(|x| x.is_finite()));
            prop_assert!(view.camera.width > 0 && view.camera.height > 0);
        }
    }

    #[test]
    fn damaged_views_are_read_without_a_panic(at in any::<prop::sample::Index>(), byte in any::<u8>(), cut in any::<bool>()) {
        let camera = Camera::look_at([1.0, 2.0, 3.0], [0.0; 3], [0.0, -1.0, 0.0], 50.0, 64, 48);
        let mut bytes = write_views(&[FileCamera { name: "7".into(), camera }]);
        let at = at.index(bytes.len());
        bytes[at] = byte;
        if cut {
            bytes.truncate(at);
        }
        read(&bytes);
    }
}

#[test]
fn deep_nesting_is_refused() {
    let deep = format!(r#"{{"views": {}"#, "[".repeat(100_000));
    assert!(read(deep.as_bytes()).is_empty());
}
