//! The learned parameters, and their initial values from a point cloud.

use std::num::NonZero;
use std::sync::Arc;

use kiddo::{ImmutableKdTree, SquaredEuclidean};
use rayon::prelude::*;
use tcgs_core::{BaseColumns, Camera, Gaussians, Image, PointCloud, distance, squared_distance};

/// [`spread_of_cameras`] above which cameras differ: one level of 255. Smaller differences are noise of the training,
/// which more training would increase.
pub(crate) const DIFFERENT: f32 = 1.0 / 255.0;

/// All learned parameters at one timestep, in stored form.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Parameters {
    /// `[N]`, the Gaussians.
    pub gaussians: Gaussians,
    /// `[N]`, mask logits `m_{n,t}`; at their initial value if masks are off.
    pub mask_logits: Vec<f32>,
    /// `[N]` whether the Gaussian belongs to the moving foreground. Not learned.
    pub foreground: Vec<bool>,
    /// `[cameras, 3]` logarithms of the cameras' colour gains.
    pub camera_gains: Vec<[f32; 3]>,
    /// `[cameras, 3]` the cameras' colour offsets.
    pub camera_offsets: Vec<[f32; 3]>,
}

/// Smallest mean squared distance from which an initial scale is taken.
pub(crate) const MIN_SQUARED_DISTANCE: f32 = 1e-7;

impl Parameters {
    /// Gaussians at the points of a cloud: isotropic, as large as the root mean squared distance to
    /// the three nearest, half opaque. Luiten et al. 2024, `initialize_params` of the released code.
    ///
    /// - `cloud`: positions in scene units, colours in `[0, 1]`
    /// - `num_cameras`: number of training cameras, each of which gets the gain 1 and the offset 0
    /// - `mask_logit`: initial value of every mask logit
    ///
    /// # Panics
    /// If the cloud is empty.
    pub fn from_cloud(cloud: &PointCloud, num_cameras: usize, mask_logit: f32) -> Self {
        let n = cloud.points.len();
        assert!(n > 0, "an empty point cloud");
        let log_scales = nearest(&cloud.points, 3)
            .into_par_iter()
            .map(|neighbors| {
                // A cloud of one point has no neighbours.
                let mean = neighbors.iter().map(|&(_, d)| d).sum::<f32>() / neighbors.len().max(1) as f32;
                [mean.max(MIN_SQUARED_DISTANCE).sqrt().ln(); 3]
            })
            .collect();
        Self {
            gaussians: Gaussians::from(BaseColumns {
                means: cloud.points.clone(),
                quats: vec![[1.0, 0.0, 0.0, 0.0]; n],
                log_scales,
                logit_opacities: vec![0.0; n],
                colors: cloud.colors.clone(),
            }),
            mask_logits: vec![mask_logit; n],
            foreground: cloud.foreground.clone(),
            camera_gains: vec![[0.0; 3]; num_cameras],
            camera_offsets: vec![[0.0; 3]; num_cameras],
        }
    }

    /// Number of Gaussians, `N`.
    pub fn num_gaussians(&self) -> usize {
        self.gaussians.num_gaussians()
    }

    /// A rendered picture in a training camera's colours, which differ by its gain and its offset. Values outside of
    /// `[0, 1]` are not clamped.
    ///
    /// - `camera`: index among the training cameras
    pub fn seen_by_camera(&self, camera: usize, picture: Image) -> Image {
        corrected(picture, [self.camera_gains[camera], self.camera_offsets[camera]])
    }

    /// `[cameras]` gain, as its logarithm, and offset.
    pub fn corrections(&self) -> Vec<[[f32; 3]; 2]> {
        self.camera_gains.iter().zip(&self.camera_offsets).map(|(&gain, &offset)| [gain, offset]).collect()
    }

    /// Appends the Gaussians of others; cameras are unchanged.
    pub(crate) fn append(&mut self, others: &Self) {
        let layout = Arc::clone(self.gaussians.layout());
        self.gaussians = Gaussians::concat(&layout, &[std::mem::take(&mut self.gaussians), others.gaussians.clone()]);
        self.mask_logits.extend_from_slice(&others.mask_logits);
        self.foreground.extend_from_slice(&others.foreground);
    }

    /// Overwrites the Gaussians at `indices` by the first ones of `others`, in that order; cameras are unchanged.
    pub(crate) fn put(&mut self, indices: &[usize], others: &Self) {
        for column in Arc::clone(self.gaussians.layout()).columns() {
            let (a, components) = (column.attribute, column.components());
            scatter(indices, others.gaussians.values(a), self.gaussians.values_mut(a), components);
        }
        scatter(indices, &others.mask_logits, &mut self.mask_logits, 1);
    }

    /// The Gaussians at `indices`, in that order, with repetitions; cameras are unchanged.
    pub fn select(&self, indices: &[usize]) -> Self {
        Self {
            gaussians: self.gaussians.select(indices),
            mask_logits: indices.iter().map(|&i| self.mask_logits[i]).collect(),
            foreground: indices.iter().map(|&i| self.foreground[i]).collect(),
            camera_gains: self.camera_gains.clone(),
            camera_offsets: self.camera_offsets.clone(),
        }
    }
}

/// Copies the first rows of one flat array to places of another.
///
/// - `indices`: row of `to` for each of the first rows of `from`
/// - `components`: numbers of a row
pub(crate) fn scatter(indices: &[usize], from: &[f32], to: &mut [f32], components: usize) {
    for (row, &i) in indices.iter().enumerate() {
        to[i * components..][..components].copy_from_slice(&from[row * components..][..components]);
    }
}

/// The `count` nearest other points of each point, nearest first, with squared distances.
pub(crate) fn nearest(points: &[[f32; 3]], count: usize) -> Vec<Vec<(u32, f32)>> {
    if points.len() < 2 || count == 0 {
        return vec![Vec::new(); points.len()];
    }
    let tree = ImmutableKdTree::new_from_slice(points).expect("finite points make a tree");
    let wanted = NonZero::new(count.min(points.len() - 1) + 1).expect("at least two");
    points
        .par_iter()
        .enumerate()
        .map(|(i, point)| {
            let found = tree.query(point).nearest_n::<SquaredEuclidean<f32>>(wanted).execute();
            let mut others: Vec<(u32, f32)> =
                found.iter().filter(|f| f.item as usize != i).map(|f| (f.item, f.distance)).collect();
            // Among coincident points the query may not return the point itself.
            others.truncate(wanted.get() - 1);
            others
        })
        .collect()
}

/// Standard deviation, over cameras of these gains and offsets, of the brightness of a grey of 0.5: of the channel in
/// which they differ most.
pub(crate) fn spread_of_cameras(cameras: &[[[f32; 3]; 2]]) -> f32 {
    let count = cameras.len() as f32;
    let spread = |channel: usize| {
        let brightness = cameras.iter().map(|[gain, offset]| 0.5 * gain[channel].exp() + offset[channel]);
        let mean = brightness.clone().sum::<f32>() / count;
        let variance = brightness.map(|value| (value - mean).powi(2)).sum::<f32>() / count;
        variance.sqrt()
    };
    (0..3).map(spread).fold(0.0, f32::max)
}

/// A rendered picture in the colours of a camera.
pub(crate) fn corrected(mut picture: Image, [gain, offset]: [[f32; 3]; 2]) -> Image {
    for channel in 0..3 {
        let (gain, offset) = (gain[channel].exp(), offset[channel]);
        picture.plane_mut(channel).iter_mut().for_each(|value| *value = gain * *value + offset);
    }
    picture
}

/// Extent of a scene: 1.1 times the largest distance of a camera's centre from the mean of all centres.
///
/// - `cameras`: of the first timestep, used for training
/// - returns: scene units; 0 for a single camera
///
/// Luiten et al. 2024, `initialize_params` of the released code.
pub fn scene_radius(cameras: &[Camera]) -> f32 {
    let centers: Vec<[f64; 3]> = cameras.iter().map(Camera::center).collect();
    let mean: [f64; 3] = std::array::from_fn(|i| centers.iter().map(|c| c[i]).sum::<f64>() / centers.len() as f64);
    (1.1 * centers.iter().map(|&center| distance(center, mean)).fold(0.0, f64::max)) as f32
}

/// The scene's radius by its cameras. If they are all at one place, the distance of points decides.
///
/// - `cameras`: at least one
/// - returns: scene units
pub(crate) fn extent(cameras: &[Camera], points: &[[f32; 3]]) -> f32 {
    match scene_radius(cameras) {
        0.0 => distance_to(&cameras[0], points),
        radius => radius,
    }
}

/// Root mean squared distance of a camera to points, scene units.
fn distance_to(camera: &Camera, points: &[[f32; 3]]) -> f32 {
    let center = camera.center();
    let squared = |p: &[f32; 3]| squared_distance(p.map(f64::from), center);
    (points.iter().map(squared).sum::<f64>() / points.len() as f64).sqrt() as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn neighbours_are_the_nearest_others() {
        let points: Vec<[f32; 3]> = (0..20).map(|i| [(i * i) as f32, 0.0, 0.0]).collect();
        let found = nearest(&points, 2);
        assert_eq!(found[5], [(4, 81.0), (6, 121.0)]);
        assert_eq!(found[0], [(1, 1.0), (2, 16.0)]);
        let same = nearest(&[[1.0; 3]; 5], 3);
        assert!(
            same.iter().enumerate().all(|(i, n)| n.len() == 3 && n.iter().all(|&(j, d)| j as usize != i && d == 0.0))
        );
    }

    #[test]
    fn a_cloud_becomes_round_half_opaque_gaussians() {
        let cloud = PointCloud {
            points: vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 2.0]],
            colors: vec![[0.5; 3]; 4],
            foreground: vec![true; 4],
        };
        let p = Parameters::from_cloud(&cloud, 2, 1.0);
        let expected = (9.0_f32 / 3.0).sqrt().ln(); // squared distances 1, 4, 4
        assert!((p.gaussians.log_scales()[0][1] - expected).abs() < 1e-6);
        assert_eq!((p.gaussians.logit_opacities()[0], p.mask_logits[0], p.camera_gains.len()), (0.0, 1.0, 2));
    }

    #[test]
    fn cameras_differ_by_more_than_one_level_of_255() {
        let camera = |gain: f32, offset: f32| [[0.0, gain.ln(), 0.0], [0.0, 0.0, offset]];
        let cameras_differ = |cameras: &[[[f32; 3]; 2]]| spread_of_cameras(cameras) > DIFFERENT;
        assert!(!cameras_differ(&[camera(1.0, 0.0), camera(1.0, 0.0)]));
        // A grey of 0.5 is brighter by half of the gain.
        assert!(!cameras_differ(&[camera(1.014, 0.0), camera(1.0, 0.0)]));
        assert!(cameras_differ(&[camera(1.018, 0.0), camera(1.0, 0.0)]));
        assert!(!cameras_differ(&[camera(1.0, 0.007), camera(1.0, 0.0)]));
        assert!(cameras_differ(&[camera(1.0, 0.009), camera(1.0, 0.0)]));
        // A brightness that all cameras share is no difference.
        assert!(!cameras_differ(&[camera(1.5, 0.1), camera(1.5, 0.1)]));
    }
}
