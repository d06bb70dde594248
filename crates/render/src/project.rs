//! Projection of one Gaussian to its splat, and its vector-Jacobian product.

use tcgs_core::{Camera, Pinhole, Real, cross, dot, rotmat_from_unit_quat, rotmat_from_unit_quat_vjp};

use crate::settings::{BLUR_VARIANCE, FOV_MARGIN, NEAR};

/// A camera's numbers for the projection, in one precision.
#[derive(Clone, Debug)]
pub struct SplatCamera<R> {
    /// The camera.
    pub pinhole: Pinhole<R>,
    /// Least `x/z` and `y/z` at which the projection is linearised; see [`FOV_MARGIN`].
    pub slope_min: [R; 2],
    /// Greatest `x/z` and `y/z` at which the projection is linearised.
    pub slope_max: [R; 2],
}

impl<R: Real> SplatCamera<R> {
    /// Rounds a camera to `R`; the range of slopes is computed in `f64` first.
    pub fn new(camera: &Camera) -> Self {
        let size = [camera.width as f64, camera.height as f64];
        let margin = |i: usize| FOV_MARGIN * size[i] / (2.0 * camera.focal[i]);
        Self {
            pinhole: Pinhole::new(camera),
            slope_min: std::array::from_fn(|i| R::of(-camera.principal[i] / camera.focal[i] - margin(i))),
            slope_max: std::array::from_fn(|i| R::of((size[i] - camera.principal[i]) / camera.focal[i] + margin(i))),
        }
    }
}

/// A splat: the 2D footprint of a Gaussian.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Projection<R> {
    /// Centre, pixels.
    pub mean2d: [R; 2],
    /// Covariance `xx, xy, yy` with the pixel's blur, px².
    pub covariance2d: [R; 3],
    /// Its inverse `xx, xy, yy`, 1/px².
    pub conic: [R; 3],
    /// Camera z, scene units.
    pub depth: R,
    /// Determinant of the covariance without the pixel's blur, px⁴.
    pub sharp_determinant: R,
}

impl<R: Real> Projection<R> {
    /// Share of its opacity that an antialiased splat keeps, 0 to 1: the square root of the ratio of the covariance's
    /// determinants before and after the blur. Yu et al. 2024 (Mip-Splatting), Eq. 10.
    #[inline(always)]
    pub fn kept_opacity(&self) -> R {
        let [xx, xy, yy] = self.covariance2d;
        (self.sharp_determinant / (xx * yy - xy * xy)).min(R::one()).sqrt()
    }
}

/// Values that forward and backward share: camera-space centre, Jacobian, and the factors of the covariance.
struct ProjectionChain<R> {
    point: [R; 3],
    /// `x/z`, `y/z` after clamping, and whether they were clamped.
    slope: [R; 2],
    clamped: [bool; 2],
    rotmat: [[R; 3]; 3],
    /// `camera_from_world * R * S`.
    factor: [[R; 3]; 3],
    /// `J * factor`: `covariance2d = root rootᵀ + blur`.
    root: [[R; 3]; 2],
}

#[inline(always)]
fn chain<R: Real>(mean: [R; 3], quat: [R; 4], scale: [R; 3], camera: &SplatCamera<R>) -> Option<ProjectionChain<R>> {
    let pinhole = &camera.pinhole;
    let point = pinhole.camera_point(mean);
    let depth = point[2];
    if depth <= R::of(NEAR) || depth.is_nan() {
        return None;
    }
    let rotmat = rotmat_from_unit_quat(quat);
    let factor: [[R; 3]; 3] = std::array::from_fn(|i| {
        std::array::from_fn(|j| {
            let w = &pinhole.rotation[i];
            (w[0] * rotmat[0][j] + w[1] * rotmat[1][j] + w[2] * rotmat[2][j]) * scale[j]
        })
    });
    let raw = [point[0] / depth, point[1] / depth];
    let slope = std::array::from_fn(|i| raw[i].max(camera.slope_min[i]).min(camera.slope_max[i]));
    let clamped = [slope[0] != raw[0], slope[1] != raw[1]];
    let root = std::array::from_fn(|i| {
        let per_depth = pinhole.focal[i] / depth;
        std::array::from_fn(|j| per_depth * (factor[i][j] - slope[i] * factor[2][j]))
    });
    Some(ProjectionChain { point, slope, clamped, rotmat, factor, root })
}

#[inline(always)]
fn invert_symmetric<R: Real>([xx, xy, yy]: [R; 3]) -> Option<[R; 3]> {
    let determinant = xx * yy - xy * xy;
    (determinant > R::zero() && determinant.is_finite())
        .then(|| [yy / determinant, -xy / determinant, xx / determinant])
}

/// Projects one Gaussian; `None` if it is culled (nearer than [`NEAR`], or not finite).
///
/// - `mean`: `[3]`, world, scene units
/// - `quat`: `[4]`, unit, `w, x, y, z`
/// - `scale`: `[3]`, activated, scene units
///
/// Zwicker et al. 2002, Eq. 29 and 31 (local affine approximation); Kerbl et al. 2023, Eq. 5.
#[inline(always)]
pub fn project<R: Real>(mean: [R; 3], quat: [R; 4], scale: [R; 3], camera: &SplatCamera<R>) -> Option<Projection<R>> {
    let chain = chain(mean, quat, scale, camera)?;
    let pinhole = &camera.pinhole;
    let [x, y, depth] = chain.point;
    let [u, v] = chain.root;
    let blur = R::of(BLUR_VARIANCE);
    let covariance2d = [dot(u, u) + blur, dot(u, v), dot(v, v) + blur];
    let conic = invert_symmetric(covariance2d)?;
    let mean2d =
        [pinhole.focal[0] * x / depth + pinhole.principal[0], pinhole.focal[1] * y / depth + pinhole.principal[1]];
    // |U × V|² is the determinant of UUᵀ without the difference of two large numbers.
    let normal = cross(u, v);
    let sharp_determinant = dot(normal, normal);
    let is_finite = mean2d[0].is_finite() && mean2d[1].is_finite();
    is_finite.then_some(Projection { mean2d, covariance2d, conic, depth, sharp_determinant })
}

/// VJP of [`Projection::kept_opacity`]: gradient to `conic` (its `xy` counted once); zero where nothing is kept.
///
/// With `B` the blur's variance and `C` the conic, `|Σ| / |Σ + B|` is `1 − B tr C + B² |C|`.
///
/// - `kept`: the share that is kept
#[inline(always)]
pub fn kept_opacity_vjp<R: Real>([xx, xy, yy]: [R; 3], kept: R, v_kept: R) -> [R; 3] {
    if kept <= R::zero() {
        return [R::zero(); 3];
    }
    let blur = R::of(BLUR_VARIANCE);
    let v = v_kept / (R::of(2.0) * kept) * blur;
    [v * (blur * yy - R::one()), -R::of(2.0) * v * blur * xy, v * (blur * xx - R::one())]
}

/// VJP of [`project`] for a Gaussian that was not culled; zero for one that was.
///
/// - `v_mean2d`, `v_conic`: gradients to the centre and to `conic` (its `xy` counted once)
/// - returns: gradients to `mean`, `quat` (without the constraint of unit length), `scale`
pub fn project_vjp<R: Real>(
    mean: [R; 3],
    quat: [R; 4],
    scale: [R; 3],
    camera: &SplatCamera<R>,
    v_mean2d: [R; 2],
    v_conic: [R; 3],
) -> ([R; 3], [R; 4], [R; 3]) {
    let Some(chain) = chain(mean, quat, scale, camera) else {
        return ([R::zero(); 3], [R::zero(); 4], [R::zero(); 3]);
    };
    let pinhole = &camera.pinhole;
    let (two, half) = (R::of(2.0), R::of(0.5));
    let [u, v] = chain.root;
    let blur = R::of(BLUR_VARIANCE);
    let Some([a, b, c]) = invert_symmetric([dot(u, u) + blur, dot(u, v), dot(v, v) + blur]) else {
        return ([R::zero(); 3], [R::zero(); 4], [R::zero(); 3]);
    };

    // d(Σ⁻¹) = −Σ⁻¹ dΣ Σ⁻¹, with the incoming gradient as a symmetric matrix.
    let (p, q, r) = (v_conic[0], half * v_conic[1], v_conic[2]);
    let (ap, aq) = (a * p + b * q, a * q + b * r);
    let (bp, bq) = (b * p + c * q, b * q + c * r);
    let v_cov = [-(ap * a + aq * b), -(ap * b + aq * c), -(bp * b + bq * c)];

    // Σ = root rootᵀ.
    let v_root: [[R; 3]; 2] = [
        std::array::from_fn(|j| two * (v_cov[0] * u[j] + v_cov[1] * v[j])),
        std::array::from_fn(|j| two * (v_cov[1] * u[j] + v_cov[2] * v[j])),
    ];

    // root[i] = focal/z * (factor[i] − slope[i] * factor[2]).
    let depth = chain.point[2];
    let mut v_point = [R::zero(); 3];
    let mut v_factor = [[R::zero(); 3]; 3];
    for i in 0..2 {
        let per_depth = pinhole.focal[i] / depth;
        for j in 0..3 {
            v_factor[i][j] = per_depth * v_root[i][j];
            v_factor[2][j] = v_factor[2][j] - per_depth * chain.slope[i] * v_root[i][j];
        }
        let root = chain.root[i];
        v_point[2] = v_point[2] - dot(v_root[i], root) / depth;
        if !chain.clamped[i] {
            let v_slope = -per_depth * dot(v_root[i], chain.factor[2]);
            v_point[i] = v_point[i] + v_slope / depth;
            v_point[2] = v_point[2] - v_slope * chain.slope[i] / depth;
        }
        // Centre: focal * x/z + principal, never clamped.
        v_point[i] = v_point[i] + per_depth * v_mean2d[i];
        v_point[2] = v_point[2] - per_depth * v_mean2d[i] * chain.point[i] / depth;
    }

    // factor = W R S.
    let w = &pinhole.rotation;
    let mut v_rotmat = [[R::zero(); 3]; 3];
    let mut v_scale = [R::zero(); 3];
    for i in 0..3 {
        for j in 0..3 {
            let v_rs = w[0][i] * v_factor[0][j] + w[1][i] * v_factor[1][j] + w[2][i] * v_factor[2][j];
            v_rotmat[i][j] = v_rs * scale[j];
            v_scale[j] = v_scale[j] + v_rs * chain.rotmat[i][j];
        }
    }
    let v_mean = std::array::from_fn(|j| w[0][j] * v_point[0] + w[1][j] * v_point[1] + w[2][j] * v_point[2]);
    (v_mean, rotmat_from_unit_quat_vjp(quat, v_rotmat), v_scale)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn splat_camera() -> SplatCamera<f64> {
        SplatCamera::new(&Camera::look_at([0.3, -0.4, -3.0], [0.0, 0.1, 0.0], [0.0, -1.0, 0.0], 40.0, 64, 48))
    }

    #[test]
    fn a_sphere_ahead_projects_to_a_circle() {
        let camera = Camera::look_at([0.0, 0.0, -2.0], [0.0; 3], [0.0, -1.0, 0.0], 50.0, 64, 48);
        let splat = project([0.0; 3], [1.0, 0.0, 0.0, 0.0], [0.1; 3], &SplatCamera::<f64>::new(&camera)).unwrap();
        assert_eq!(splat.mean2d, [32.0, 24.0]);
        assert_eq!(splat.depth, 2.0);
        let variance = (50.0_f64 * 0.1 / 2.0).powi(2) + 0.3;
        assert!((splat.covariance2d[0] - variance).abs() < 1e-12 && splat.covariance2d[1].abs() < 1e-12);
    }

    #[test]
    fn what_is_near_or_not_finite_is_culled() {
        let quat = [1.0, 0.0, 0.0, 0.0];
        assert!(project([0.3, -0.4, -2.85], quat, [0.1; 3], &splat_camera()).is_none());
        assert!(project([f64::NAN, 0.0, 0.0], quat, [0.1; 3], &splat_camera()).is_none());
        assert!(project([0.0; 3], quat, [f64::INFINITY; 3], &splat_camera()).is_none());
    }

    #[test]
    fn a_splat_keeps_the_quotient_of_its_determinants() {
        let quat = tcgs_core::normalize([0.8, 0.3, -0.4, 0.2]);
        for scale in [[0.2, 0.05, 0.4], [0.01, 0.02, 0.005], [1e-4, 0.3, 0.2]] {
            let splat = project([0.2, 0.1, 0.5], quat, scale, &splat_camera()).unwrap();
            let [xx, xy, yy] = splat.covariance2d;
            let determinant = |blur: f64| (xx - blur) * (yy - blur) - xy * xy;
            let kept = splat.kept_opacity();
            let expected = (determinant(BLUR_VARIANCE) / determinant(0.0)).sqrt();
            assert!((kept - expected).abs() < 1e-9, "{kept} against {expected}");
            let found = kept_opacity_vjp(splat.conic, kept, 0.7);
            for i in 0..3 {
                let at = |h: f64| {
                    let mut conic = splat.conic;
                    conic[i] += h;
                    let determinant = conic[0] * conic[2] - conic[1] * conic[1];
                    let kept = 1.0 - BLUR_VARIANCE * (conic[0] + conic[2]) + BLUR_VARIANCE.powi(2) * determinant;
                    0.7 * kept.sqrt()
                };
                let difference = (at(1e-7) - at(-1e-7)) / 2e-7;
                assert!((difference - found[i]).abs() < 1e-5 * difference.abs().max(1.0), "{difference} {found:?}");
            }
        }
        // A Gaussian without extent keeps no opacity.
        let flat = project([0.2, 0.1, 0.5], quat, [0.0; 3], &splat_camera()).unwrap();
        assert_eq!((flat.kept_opacity(), kept_opacity_vjp(flat.conic, 0.0, 1.0)), (0.0, [0.0; 3]));
    }

    #[test]
    fn vjp_matches_central_differences_inside_and_beside_the_image() {
        let quat = tcgs_core::normalize([0.8, 0.3, -0.4, 0.2]);
        let (v_mean2d, v_conic) = ([0.7, -1.3], [0.9, 0.4, -1.1]);
        // The second one is clamped in x, the third in both.
        for mean in [[0.2, 0.1, 0.5], [4.0, 0.3, 0.5], [-5.0, 5.0, 0.4]] {
            let x: [f64; 10] = [mean[0], mean[1], mean[2], quat[0], quat[1], quat[2], quat[3], 0.2, 0.05, 0.4];
            let split = |x: [f64; 10]| ([x[0], x[1], x[2]], [x[3], x[4], x[5], x[6]], [x[7], x[8], x[9]]);
            let loss = |x: [f64; 10]| {
                let (m, q, s) = split(x);
                let p = project(m, q, s, &splat_camera()).unwrap();
                dot(p.mean2d, v_mean2d) + dot(p.conic, v_conic)
            };
            let (m, q, s) = split(x);
            let (v_m, v_q, v_s) = project_vjp(m, q, s, &splat_camera(), v_mean2d, v_conic);
            let gradient = [v_m.as_slice(), &v_q, &v_s].concat();
            for i in 0..10 {
                let h = 1e-5;
                let at = |d: f64| {
                    let mut moved = x;
                    moved[i] += d;
                    loss(moved)
                };
                let difference = (at(h) - at(-h)) / (2.0 * h);
                let tolerance = 1e-6 * difference.abs().max(1.0);
                assert!(
                    (difference - gradient[i]).abs() < tolerance,
                    "{mean:?} {i}: {difference} against {}",
                    gradient[i]
                );
            }
        }
    }
}
