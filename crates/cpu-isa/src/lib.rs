#![doc = include_str!("../README.md")]

use std::fmt;
use std::str::FromStr;
use std::sync::OnceLock;

/// The environment variable that forces the instruction set.
pub const VARIABLE: &str = "SPARSESPLAT_ISA";

/// An instruction set, from the narrowest to the widest.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Isa {
    /// No vector code of ours.
    Scalar,
    /// aarch64 with NEON: 128 bits.
    Neon,
    /// x86-64-v3: AVX2, FMA, BMI1, BMI2, LZCNT, POPCNT: 256 bits.
    Avx2,
    /// x86-64-v4: AVX-512 F, BW, CD, DQ, VL besides: 512 bits.
    Avx512,
}

impl Isa {
    /// Every set, whether the processor has it or not.
    pub const ALL: [Self; 4] = [Self::Scalar, Self::Neon, Self::Avx2, Self::Avx512];

    /// The name in [`VARIABLE`], in reports and in recipes.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Scalar => "scalar",
            Self::Neon => "neon",
            Self::Avx2 => "avx2",
            Self::Avx512 => "avx512",
        }
    }

    /// Whether the processor has it. The standard library asks the processor once.
    #[must_use]
    pub fn is_available(self) -> bool {
        match self {
            Self::Scalar => true,
            #[cfg(target_arch = "aarch64")]
            Self::Neon => std::arch::is_aarch64_feature_detected!("neon"),
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => {
                is_x86_feature_detected!("avx2")
                    && is_x86_feature_detected!("fma")
                    && is_x86_feature_detected!("bmi1")
                    && is_x86_feature_detected!("bmi2")
                    && is_x86_feature_detected!("lzcnt")
                    && is_x86_feature_detected!("popcnt")
            }
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => {
                Self::Avx2.is_available()
                    && is_x86_feature_detected!("avx512f")
                    && is_x86_feature_detected!("avx512bw")
                    && is_x86_feature_detected!("avx512cd")
                    && is_x86_feature_detected!("avx512dq")
                    && is_x86_feature_detected!("avx512vl")
            }
            #[allow(unreachable_patterns)]
            _ => false,
        }
    }

    /// The sets that the processor has, the narrowest first.
    #[must_use]
    pub fn available() -> Vec<Self> {
        Self::ALL.into_iter().filter(|isa| isa.is_available()).collect()
    }

    /// The widest set that the processor has.
    #[must_use]
    pub fn widest() -> Self {
        Self::available().last().copied().unwrap_or(Self::Scalar)
    }

    /// The set that [`VARIABLE`] names, or the widest where it is not set.
    ///
    /// # Errors
    /// If it names no set, or one that the processor lacks.
    pub fn requested() -> Result<Self, Error> {
        match std::env::var_os(VARIABLE) {
            None => Ok(Self::widest()),
            Some(name) => {
                let isa: Self = name.to_string_lossy().parse()?;
                if isa.is_available() { Ok(isa) } else { Err(Error::Lacking(isa)) }
            }
        }
    }

    /// The set that vector code runs on unless it is told otherwise: [`requested`](Self::requested), asked for once.
    ///
    /// # Panics
    /// If [`VARIABLE`] cannot be fulfilled. A program calls [`requested`](Self::requested) first and reports the error.
    #[must_use]
    pub fn in_use() -> Self {
        static IN_USE: OnceLock<Isa> = OnceLock::new();
        *IN_USE.get_or_init(|| Self::requested().unwrap_or_else(|error| panic!("{error}")))
    }
}

impl fmt::Display for Isa {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Isa {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self, Error> {
        let found = Self::ALL.into_iter().find(|isa| isa.name() == name);
        found.ok_or_else(|| Error::Unknown(name.to_owned()))
    }
}

/// What is wrong with a request for an instruction set.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Error {
    /// No set has this name.
    Unknown(String),
    /// The processor lacks the set.
    Lacking(Isa),
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let names = |sets: &[Isa]| sets.iter().map(|isa| isa.name()).collect::<Vec<_>>().join(", ");
        match self {
            Self::Unknown(name) => {
                write!(f, "{VARIABLE} is {name:?}; instruction sets are {}", names(&Isa::ALL))
            }
            Self::Lacking(isa) => {
                write!(f, "{VARIABLE} asks for {isa}; this processor has {}", names(&Isa::available()))
            }
        }
    }
}

impl std::error::Error for Error {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sets_have_names_and_an_order() {
        for isa in Isa::ALL {
            assert_eq!(isa.name().parse(), Ok(isa));
        }
        assert!(Isa::ALL.is_sorted());
        assert_eq!("sse9".parse::<Isa>(), Err(Error::Unknown("sse9".into())));
        assert!("".parse::<Isa>().unwrap_err().to_string().contains("scalar, neon, avx2, avx512"));
    }

    #[test]
    fn the_set_in_use_is_one_that_the_processor_has() {
        assert_eq!(Isa::available()[0], Isa::Scalar);
        assert!(Isa::available().contains(&Isa::in_use()));
        assert!(Isa::in_use() <= Isa::widest());
        // No processor has both.
        let lacking = Isa::ALL.into_iter().find(|isa| !isa.is_available()).unwrap();
        assert!(Error::Lacking(lacking).to_string().contains(Isa::widest().name()));
    }

    #[test]
    fn a_wide_set_contains_the_narrower_ones_of_its_platform() {
        if Isa::Avx512.is_available() {
            assert!(Isa::Avx2.is_available());
        }
        assert!(!(Isa::Neon.is_available() && Isa::Avx2.is_available()));
    }
}
