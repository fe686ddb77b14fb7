//! Generated scenes: rooms, desks, shelves, facades, gardens and woods, each with the path of a camera that sees it well.

mod desk;
mod dwelling;
mod facade;
mod form;
mod furniture;
mod garden;
mod house;
mod palette;
mod plants;
mod room;
mod set;
mod shell;
mod shelves;
mod small;
mod sun;
mod view;
mod wild;
mod wood;

#[cfg(test)]
mod tests;

use crate::random::Random;
use crate::{Scene, Sky, Sun, Trajectory};
use serde::{Deserialize, Serialize};
use set::Set;

pub use dwelling::generate_dwelling;
pub use wild::generate_in_the_wild;

/// Kinds of scenes that [`generate`] makes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[non_exhaustive]
pub enum Kind {
    /// A room to live in: furniture along the walls and in the middle. The camera walks along one wall.
    Room,
    /// A desk at a wall with what lies and stands on it. The camera goes around it.
    Desk,
    /// A wall of shelves with books and other things. The camera walks past.
    Shelves,
    /// A row of houses across a street. The camera walks along the other pavement.
    Facade,
    /// A garden with trees, beds and furniture. The camera goes around its open side.
    Garden,
    /// A wood with glades and a track. The camera flies over it.
    Wood,
}

impl Kind {
    /// All kinds.
    pub const ALL: [Self; 6] =
        [Self::Room, Self::Desk, Self::Shelves, Self::Facade, Self::Garden, Self::Wood];

    /// The kind that belongs to a seed, where any at eye level will do.
    #[must_use]
    pub fn of_seed(seed: u64) -> Self {
        let kinds = [Self::Room, Self::Desk, Self::Shelves, Self::Facade, Self::Garden];
        Random::new(seed, 0x616e_7900).pick(&kinds)
    }

    /// The kind that belongs to a seed [in the wild](generate_in_the_wild): seven of ten are outdoors, where stereo has its
    /// troubles, and three of these are woods.
    #[must_use]
    pub fn of_seed_in_the_wild(seed: u64) -> Self {
        let indoors = [Self::Room, Self::Desk, Self::Shelves];
        let outdoors =
            [Self::Facade, Self::Facade, Self::Garden, Self::Garden, Self::Wood, Self::Wood, Self::Wood];
        Random::new(seed, 0x7769_6b00).pick(&[&indoors[..], &outdoors[..]].concat())
    }

    /// What a user calls it.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Room => "room",
            Self::Desk => "desk",
            Self::Shelves => "shelves",
            Self::Facade => "facade",
            Self::Garden => "garden",
            Self::Wood => "wood",
        }
    }
}

/// Draws a path that may be of use.
type Draw = Box<dyn FnMut(&mut Random) -> Trajectory>;

/// What a kind of scene has besides its things.
struct Plan {
    sky: Sky,
    sun: Option<Sun>,
    wish: view::Wish,
    draw: Draw,
}

/// A scene of a kind. The same seed gives the same scene.
///
/// It brings its own [`Photographs`](crate::Photographs): a path along which neighbouring pictures overlap by about three
/// quarters and no thing comes nearer to the camera than 0.3 m.
///
/// # Panics
/// If the generator states a number that a description must not have: a mistake of this crate.
#[must_use]
pub fn generate(kind: Kind, seed: u64) -> Scene {
    for attempt in 0..100 {
        let (mut scene, mut random, wish, draw) = build(kind, seed, attempt);
        if view::photograph(&mut scene, &mut random, wish, draw) {
            return scene;
        }
    }
    panic!("no camera finds its way through a {kind:?} of seed {seed}");
}

/// One attempt at a scene: its things and its light, what its camera must see, and paths that may do.
fn build(kind: Kind, seed: u64, attempt: u32) -> (Scene, Random, view::Wish, Draw) {
    let stream = match kind {
        Kind::Room => 0x726f_6f00,
        Kind::Desk => 0x6465_7300,
        Kind::Shelves => 0x7368_6500,
        Kind::Facade => 0x6661_6300,
        Kind::Garden => 0x6761_7200,
        Kind::Wood => 0x776f_6f00,
    };
    let mut set = Set::new(Random::new(seed, stream + attempt));
    let Plan { sky, sun, wish, draw } = match kind {
        Kind::Room => room::room(&mut set),
        Kind::Desk => desk::desk(&mut set),
        Kind::Shelves => shelves::shelves(&mut set),
        Kind::Facade => facade::facade(&mut set),
        Kind::Garden => garden::garden(&mut set),
        Kind::Wood => wood::wood(&mut set),
    };
    let Set { random, primitives, meshes, lamps } = set;
    (Scene { primitives, meshes, lamps, sun, ..Scene::under(sky) }, random, wish, draw)
}

/// A scene of any kind at eye level. The same seed gives the same scene.
///
/// # Panics
/// As [`generate`].
#[must_use]
pub fn generate_any(seed: u64) -> Scene {
    generate(Kind::of_seed(seed), seed)
}
