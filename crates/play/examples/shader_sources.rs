//! Writes every shader of the renderer and the player, as the GPU gets it, to `FOLDER/NAME.wgsl`, for other compilers
//! to judge.
//!
//! `cargo run -p tcgs-play --example shader_sources -- FOLDER`

use std::io::{Error, Write};
use std::path::Path;
use std::{env, fs, io};

fn main() -> io::Result<()> {
    let folder = env::args_os().nth(1).ok_or_else(|| Error::other("which folder?"))?;
    let folder = Path::new(&folder);
    fs::create_dir_all(folder)?;
    let mut sources = tcgs_render::device::sources();
    sources.extend(tcgs_play::sources());
    for (name, source) in &sources {
        fs::write(folder.join(format!("{name}.wgsl")), source)?;
    }
    writeln!(io::stdout(), "{} shaders written to {}", sources.len(), folder.display())
}
