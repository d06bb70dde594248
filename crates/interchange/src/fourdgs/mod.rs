//! `.4dgs` files (<https://4dgs.dev>), read and written through the crate `fourdgs`: a whole scene over time in one
//! file.
//!
//! Their time is continuous: a Gaussian lives in a window of time, may move at a constant velocity, and may fade in and
//! out. Here time has steps. Reading asks for the state at each step; writing gives a Gaussian a window of the steps at
//! which no bit of it changes, without velocity or fading. Where a bit changes, the Gaussian dies and is born again.
//!
//! | there | here |
//! |---|---|
//! | position at a time | `means` |
//! | rotation `x, y, z, w` | `quats` |
//! | scales, linear | `log_scales` |
//! | colour, sRGB as displayed | `colors` |
//! | opacity, activated, faded | `logit_opacities` |
//! | harmonics, 8 bits between -4 and 4, all of red, then of green, then of blue | `sh1` to `sh3` |
//!
//! Both temporal models are read. In `keyframe-delta` every state is a timestep, at its beginning, and Gaussians come
//! in the order of their identities. In `gaussian-birth` a timestep is as long as the shortest window if that is a
//! tenth of a second or less, as in sequences of frames. Otherwise it is a thirtieth of a second long. The state is
//! that of the timestep's middle. Writing uses `gaussian-birth`, the model that every reader has and that holds
//! harmonics.
//!
//! A file that says `y-up-right-handed` has the axes of glTF; any other has those of PLY files, as in the format's own
//! converter. Written files say it. Streams compressed by Zstandard are not read.

mod bounds;
mod read;
mod states;
mod write;

pub use read::FourdgsFile;
pub use write::fourdgs_bytes;

/// The coordinate system of glTF, by its name in these files.
const Y_UP: &str = "y-up-right-handed";

/// One line of the crate's message.
fn one_line(error: &::fourdgs::Error) -> String {
    error.to_string().replace('\n', " ")
}

#[cfg(test)]
mod tests;
