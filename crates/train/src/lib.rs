//! Training of dynamic Gaussians from multi-view images
