//! The player's own shaders are valid WGSL within the limits of every browser. The check needs no GPU.

use wgpu::naga::AddressSpace;
use wgpu::naga::front::wgsl;
use wgpu::naga::valid::{Capabilities, ValidationFlags, Validator};

/// Most storage buffers in one shader.
const MAX_STORAGE_BUFFERS: usize = 8;

#[test]
fn every_shader_is_valid_within_the_limits_of_browsers() {
    let sources = tcgs_play::sources();
    assert!(sources.len() > 5);
    for (name, source) in sources {
        let module =
            wgsl::parse_str(&source).unwrap_or_else(|e| panic!("{}", e.emit_to_string_with_path(&source, &name)));
        // No capabilities, because a browser may lack any of them.
        let info = Validator::new(ValidationFlags::all(), Capabilities::empty())
            .validate(&module)
            .unwrap_or_else(|e| panic!("{}", e.emit_to_string_with_path(&source, &name)));
        assert!(!module.entry_points.is_empty(), "{name} has no entry point");
        for (index, entry) in module.entry_points.iter().enumerate() {
            let used = module.global_variables.iter().filter(|(handle, global)| {
                matches!(global.space, AddressSpace::Storage { .. }) && !info.get_entry_point(index)[*handle].is_empty()
            });
            let count = used.count();
            assert!(count <= MAX_STORAGE_BUFFERS, "{} of {name} uses {count} storage buffers", entry.name);
        }
    }
}
