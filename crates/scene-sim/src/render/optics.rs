//! Reflection and refraction of unit directions at smooth surfaces.

use glam::DVec3;

/// What happens to light at the border of two media.
#[derive(Debug, Clone, Copy)]
pub(super) struct Border {
    /// Index of refraction where the light comes from, divided by that where it goes to.
    pub(super) ratio: f64,
    /// Cosine of the angle between ray and normal, 0 to 1.
    pub(super) cosine: f64,
}

/// The direction of a mirror's reflection.
pub(super) fn reflected(direction: DVec3, normal: DVec3) -> DVec3 {
    direction - normal * (2.0 * direction.dot(normal))
}

impl Border {
    /// Cosine of the angle on the other side (Snell); `None` where the reflection is total.
    pub(super) fn inner_cosine(&self) -> Option<f64> {
        let squared = 1.0 - self.ratio * self.ratio * (1.0 - self.cosine * self.cosine);
        (squared >= 0.0).then(|| squared.sqrt())
    }

    /// Share of unpolarised light that is thrown back (Fresnel).
    pub(super) fn reflectance(&self) -> f64 {
        let Some(inner) = self.inner_cosine() else { return 1.0 };
        let share = |a: f64, b: f64| if a + b > 0.0 { ((a - b) / (a + b)).powi(2) } else { 1.0 };
        let across = share(self.ratio * self.cosine, inner);
        let along = share(self.ratio * inner, self.cosine);
        0.5 * (across + along)
    }

    /// Share that a pane, with two such surfaces, throws back, all reflections between them counted.
    pub(super) fn pane_reflectance(&self) -> f64 {
        let one = self.reflectance();
        2.0 * one / (1.0 + one)
    }

    /// The direction behind the surface; `None` where the reflection is total. The normal is on the ray's side.
    pub(super) fn refracted(&self, direction: DVec3, normal: DVec3) -> Option<DVec3> {
        let inner = self.inner_cosine()?;
        Some((direction * self.ratio + normal * (self.ratio * self.cosine - inner)).normalize())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn rays_obey_snell_and_energy_stays_within_bounds(
            angle in 0.0..1.57f64, turn in 0.0..6.2f64, index in 1.0..3.0f64, out in any::<bool>(),
        ) {
            let ratio = if out { index } else { 1.0 / index };
            let (sine, cosine) = angle.sin_cos();
            let direction = DVec3::new(sine * turn.cos(), sine * turn.sin(), -cosine);
            let border = Border { ratio, cosine };
            for share in [border.reflectance(), border.pane_reflectance()] {
                prop_assert!((0.0..=1.0).contains(&share));
            }
            prop_assert!((reflected(direction, DVec3::Z) * DVec3::new(1.0, 1.0, -1.0) - direction).length() < 1e-12);
            match border.refracted(direction, DVec3::Z) {
                Some(behind) => {
                    let sine_behind = behind.truncate().length();
                    prop_assert!((sine_behind - ratio * sine).abs() < 1e-9);
                    prop_assert!(behind.z < 0.0 && behind.truncate().dot(direction.truncate()) >= 0.0);
                    // Light that goes the other way loses as much.
                    let back = Border { ratio: 1.0 / ratio, cosine: -behind.z };
                    prop_assert!((back.reflectance() - border.reflectance()).abs() < 1e-6);
                }
                None => prop_assert!(ratio * sine > 1.0 && border.reflectance() == 1.0),
            }
        }
    }

    #[test]
    fn glass_has_the_textbook_figures() {
        let straight = Border { ratio: 1.0 / 1.5, cosine: 1.0 };
        assert!((straight.reflectance() - 0.04).abs() < 1e-12);
        assert!((straight.pane_reflectance() - 0.08 / 1.04).abs() < 1e-12);
        // Brewster's angle: the part polarised in the plane of incidence is not reflected at all.
        let tangent: f64 = 1.5;
        let brewster = Border { ratio: 1.0 / 1.5, cosine: 1.0 / tangent.hypot(1.0) };
        let across = ((1.0 - 1.5f64.powi(2)) / (1.0 + 1.5f64.powi(2))).powi(2);
        assert!((brewster.reflectance() - 0.5 * across).abs() < 1e-12);
        let none = Border { ratio: 1.0, cosine: 0.3 };
        assert!(none.reflectance() < 1e-30);
    }
}
