//! What the allocator does with memory that is free.

/// Keeps up to 64 MiB of free memory at the end of each arena, of which there is about one per thread. Stages take and return buffers of the
/// size of a photograph many times; glibc gives many of those back to the system, which then clears each page again: a thirtieth of the time of a
/// scene of six photographs. Both limits are where glibc's own adjustment ends when it has seen larger buffers.
#[cfg(all(target_os = "linux", target_env = "gnu", target_pointer_width = "64"))]
pub(crate) fn keep_free() {
    const MIB: libc::c_int = 1 << 20;
    // SAFETY: called before there are other threads; it sets two limits of the allocator, which glibc then no longer adjusts.
    #[allow(unsafe_code)]
    unsafe {
        // Larger blocks are pages of their own, which go back as they are freed. It is the largest value that glibc takes.
        libc::mallopt(libc::M_MMAP_THRESHOLD, 32 * MIB);
        libc::mallopt(libc::M_TRIM_THRESHOLD, 64 * MIB);
    }
}

/// Other allocators are left as they are.
#[cfg(not(all(target_os = "linux", target_env = "gnu", target_pointer_width = "64")))]
pub(crate) fn keep_free() {}
