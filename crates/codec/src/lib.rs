//! Compression of dynamic Gaussians and the .tcgs container
