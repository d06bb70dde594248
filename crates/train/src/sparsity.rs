//! How sparse training views are. Where few images show a place, training fits each image by itself, and pictures from
//! elsewhere are worse.

use rayon::prelude::*;
use tcgs_core::{Camera, Pinhole};

/// Images that a Gaussian is in, on average, up to which views are sparse.
const SPARSE: f32 = 6.0;

/// Images that a Gaussian is in, on average, from which on views are not sparse at all.
const DENSE: f32 = 7.0;

/// How sparse views are: 1 where a Gaussian is in up to six of their images on average, 0 from seven images on, and in
/// proportion between. Gaussians in no image do not count.
///
/// - `means`: `[N, 3]`, scene units
/// - `cameras`: one for each view
pub fn view_sparsity(means: &[[f32; 3]], cameras: &[Camera]) -> f32 {
    let pinholes: Vec<Pinhole<f32>> = cameras.iter().map(Pinhole::new).collect();
    let num_images = |&mean: &[f32; 3]| pinholes.iter().filter(|pinhole| pinhole.pixel(mean).is_some()).count();
    let counts: Vec<usize> = means.par_iter().map(num_images).filter(|&count| count > 0).collect();
    let mean = counts.iter().sum::<usize>() as f32 / counts.len().max(1) as f32;
    if counts.is_empty() { 0.0 } else { ((DENSE - mean) / (DENSE - SPARSE)).clamp(0.0, 1.0) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn views_are_sparse_where_gaussians_are_in_few_images() {
        let camera = |focal| Camera::look_at([0.0; 3], [0.0, 0.0, 2.0], [0.0, -1.0, 0.0], focal, 100, 100);
        let (middle, side, behind) = ([0.0, 0.0, 2.0], [1.0, 0.0, 2.0], [0.0, 0.0, -2.0]);
        let sparsity = |count: usize, means: &[[f32; 3]]| view_sparsity(means, &vec![camera(50.0); count]);
        assert_eq!([6, 7, 12].map(|count| sparsity(count, &[middle])), [1.0, 0.0, 0.0]);
        let with_narrow = [vec![camera(50.0); 6], vec![camera(200.0)]].concat();
        assert_eq!(view_sparsity(&[middle, side], &with_narrow), 0.5, "one is in six images, one in seven");
        assert_eq!(sparsity(7, &[middle, behind, behind]), 0.0, "what is in no image does not count");
        assert_eq!(sparsity(3, &[behind]), 0.0);
    }
}
