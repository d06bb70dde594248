//! Other programs' model files: Dynamic 3D Gaussians params.npz
