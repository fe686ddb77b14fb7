use std::io;

/// What can go wrong.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// Numbers of the page are not finite, which JSON cannot hold.
    #[error("the page's numbers cannot be written as JSON")]
    Json(#[from] serde_json::Error),
    /// A packed scene ends early or has bytes left over.
    #[error("the packed scene has {found} bytes, expected {expected}")]
    Packed {
        /// Bytes that follow from the header.
        expected: usize,
        /// Bytes that are there.
        found: usize,
    },
    /// A scene or a camera is not valid.
    #[error(transparent)]
    Scene(#[from] gs_scene::Error),
    /// A path needs a camera.
    #[error("a path needs at least one camera")]
    NoCamera,
    /// Another program listens on the port.
    #[error(
        "port {port} on 127.0.0.1 is taken by another program; choose another port, or 0 for any free port"
    )]
    PortTaken {
        /// The port.
        port: u16,
    },
    /// The server cannot listen or answer.
    #[error("cannot serve on 127.0.0.1:{port}")]
    Serve {
        /// The port.
        port: u16,
        /// The reason.
        source: io::Error,
    },
}

/// With [`Error`].
pub type Result<T> = std::result::Result<T, Error>;
