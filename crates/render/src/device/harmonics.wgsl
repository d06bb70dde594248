// Real spherical harmonics of degrees 1 to 3, with the functions and signs of `core/src/harmonics.rs`.

const C1 = 0.4886025119029199;
const C20 = 0.31539156525252005;
const C21 = 1.0925484305920792;
const C22 = 0.5462742152960396;
const C30 = 0.3731763325901154;
const C31 = 0.4570457994644658;
const C32 = 1.445305721320277;
const C33 = 0.5900435899266435;

// Their values in a direction of unit length, by degree and then by order.
fn harmonics(d: vec3<f32>) -> array<f32, 15> {
    let x = d.x;
    let y = d.y;
    let z = d.z;
    let xx = x * x;
    let yy = y * y;
    let zz = z * z;
    return array(
        -C1 * y,
        C1 * z,
        -C1 * x,
        C21 * x * y,
        -C21 * y * z,
        C20 * (2.0 * zz - xx - yy),
        -C21 * x * z,
        C22 * (xx - yy),
        -C33 * y * (3.0 * xx - yy),
        2.0 * C32 * x * y * z,
        -C31 * y * (4.0 * zz - xx - yy),
        C30 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy),
        -C31 * x * (4.0 * zz - xx - yy),
        C32 * z * (xx - yy),
        -C33 * x * (xx - 3.0 * yy),
    );
}
