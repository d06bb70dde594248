//! One iteration of the optimisation.

pub mod cpu;
