//! What the allocator does with memory that is free.

/// Keeps up to 64 MB of free memory. Stages take and return buffers of the size of a photograph many times; by default glibc gives most of
/// those back to the system, which then clears each page again: a thirtieth of the time of a scene of six photographs.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
pub(crate) fn keep_free() {
    const MIB: libc::c_int = 1 << 20;
    // SAFETY: called before there are other threads; it changes two numbers of the allocator.
    #[allow(unsafe_code)]
    unsafe {
        // Larger blocks are pages of their own, which go back as they are freed. It is the largest value that glibc takes.
        libc::mallopt(libc::M_MMAP_THRESHOLD, 32 * MIB);
        libc::mallopt(libc::M_TRIM_THRESHOLD, 64 * MIB);
    }
}

/// Other allocators are left as they are.
#[cfg(not(all(target_os = "linux", target_env = "gnu")))]
pub(crate) fn keep_free() {}
