//! Differentiable Gaussian rasterization on the CPU
