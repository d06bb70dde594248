//! The library for C: its functions, called as a program in C does, and its header.

// Test helpers may unwrap, like tests.
#![allow(clippy::unwrap_used)]

mod functions;
mod header;
