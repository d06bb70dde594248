//! How sparse training views are. Where few images see a place, training fits single images, and other cameras see that.

use rayon::prelude::*;
use tcgs_core::{Camera, Pinhole};

/// Images that a Gaussian is in, on average, up to which views are sparse.
const SPARSE: f32 = 6.0;

/// Images that a Gaussian is in, on average, from which on views are not sparse at all.
const DENSE: f32 = 9.0;

/// How sparse views are: 1 where a Gaussian is in up to six of their images on average, 0 from nine images on, and in
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
        let camera = Camera::look_at([0.0; 3], [0.0, 0.0, 2.0], [0.0, -1.0, 0.0], 50.0, 100, 100);
        let (seen, unseen) = ([0.0, 0.0, 2.0], [0.0, 0.0, -2.0]);
        let sparsity = |count: usize, means: &[[f32; 3]]| view_sparsity(means, &vec![camera.clone(); count]);
        assert_eq!([6, 9, 12].map(|count| sparsity(count, &[seen])), [1.0, 0.0, 0.0]);
        assert!((sparsity(7, &[seen]) - 2.0 / 3.0).abs() < 1e-6);
        assert_eq!(sparsity(9, &[seen, unseen, unseen]), 0.0, "what is in no image does not count");
        assert_eq!(sparsity(3, &[unseen]), 0.0);
    }
}
