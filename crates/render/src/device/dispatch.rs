//! Number of workgroups of a dispatch: one thread per element, in workgroups of one size, within the limits of every
//! adapter.

/// Threads per workgroup in every shader with one thread per element.
pub const WORKGROUP: u32 = 256;

/// Most workgroups along x in a dispatch that may need several rows; the rest go along y.
pub const MAX_GROUPS_X: u32 = 32_768;

/// Most workgroups along one dimension of a dispatch that every adapter accepts.
pub(crate) const MAX_GROUPS: usize = 65_535;

/// Most elements in one dispatch along x with one thread per element.
pub const MAX_THREADS: usize = MAX_GROUPS * WORKGROUP as usize;

/// Workgroups along x, y and z for `len` elements with one thread each, [`WORKGROUP`] threads per workgroup.
///
/// - `len`: at most [`MAX_THREADS`]
pub fn groups_over(len: usize) -> [u32; 3] {
    [(len as u32).div_ceil(WORKGROUP), 1, 1]
}

/// Workgroups along x, y and z for at least `len` workgroups. More than [`MAX_GROUPS_X`] fill several rows, and the
/// last row may be too long. A workgroup's number is `workgroup_id.y * MAX_GROUPS_X + workgroup_id.x`; a workgroup
/// whose number is `len` or more does nothing.
///
/// ```
/// assert_eq!(tcgs_render::device::groups_in_rows(5), [5, 1, 1]);
/// assert_eq!(tcgs_render::device::groups_in_rows(70_000), [32_768, 3, 1]);
/// ```
pub fn groups_in_rows(len: usize) -> [u32; 3] {
    let len = len as u32;
    [len.min(MAX_GROUPS_X), len.div_ceil(MAX_GROUPS_X), 1]
}
