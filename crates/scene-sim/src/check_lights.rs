//! The rules for lights, finishes and photographs.

use crate::check::Place;
use crate::{Error, Finish, Lamp, Photographs, Result, Scene, Sky, Sun};
use gs_scene::Distortion;

impl Place<'_> {
    pub(crate) fn finish(&self, finish: Finish) -> Result<()> {
        match finish {
            Finish::Glass { index } => self.rule((1.0..=3.0).contains(&index), "index", index, "1 to 3"),
            Finish::Matte | Finish::Mirror | Finish::Baked => Ok(()),
        }
    }

    fn sun(&self, sun: &Sun) -> Result<()> {
        self.point("towards", sun.towards)?;
        let length = sun.towards.length();
        self.rule(length > 1e-9, "length of towards", length, "more than 0")?;
        self.colour("colour", sun.colour)?;
        self.strength("strength", sun.strength)?;
        self.rule((0.0..=90.0).contains(&sun.diameter), "diameter", sun.diameter, "0 to 90 degrees")
    }

    fn lamp(&self, lamp: &Lamp) -> Result<()> {
        self.point("centre", lamp.centre)?;
        self.point("rotation", lamp.rotation)?;
        lamp.size.to_array().into_iter().try_for_each(|edge| self.extent("size", edge))?;
        self.colour("colour", lamp.colour)?;
        self.strength("strength", lamp.strength)
    }

    fn sky(&self, sky: &Sky) -> Result<()> {
        self.colour("zenith", sky.zenith)?;
        self.colour("horizon", sky.horizon)?;
        self.colour("ground", sky.ground)?;
        self.strength("light", sky.light)?;
        sky.occlusion.map_or(Ok(()), |occlusion| {
            self.extent("reach of the occlusion", occlusion.reach)?;
            let rays = occlusion.rays;
            self.rule((1..=256).contains(&rays), "rays of the occlusion", rays.into(), "1 to 256")
        })
    }

    fn photographs(&self, photographs: &Photographs) -> Result<()> {
        let Photographs { width, height, field_of_view, count, .. } = *photographs;
        for (field, pixels) in [("width", width), ("height", height)] {
            self.rule((1..=1 << 15).contains(&pixels), field, pixels as f64, "1 to 32768 pixels")?;
        }
        let angle = field_of_view;
        self.rule((1e-3..=175.0).contains(&angle), "field_of_view", angle, "0.001 to 175 degrees")?;
        self.rule((1..=1_000_000).contains(&count), "count", count as f64, "1 to 1000000")?;
        let found = photographs.samples;
        if !(1..=4096).contains(&found) {
            return Err(Error::Samples { found });
        }
        if let Some(distortion) = &photographs.distortion {
            let Distortion { k1, k2, k3, p1, p2 } = *distortion;
            for (field, value) in [("k1", k1), ("k2", k2), ("k3", k3), ("p1", p1), ("p2", p2)] {
                self.rule(value.abs() <= 1e3, field, value, "-1000 to 1000")?;
            }
        }
        if let Some(aperture) = &photographs.aperture {
            self.extent("diameter of the aperture", aperture.diameter)?;
            self.period("focus of the aperture", aperture.focus)?;
        }
        let shutters =
            [("motion_blur", photographs.motion_blur), ("rolling_shutter", photographs.rolling_shutter)];
        for (field, share) in shutters {
            let share = share.unwrap_or(0.0);
            self.rule((0.0..=1.0).contains(&share), field, share, "0 to 1")?;
        }
        if let Some(exposure) = &photographs.exposure {
            self.rule((0.0..=4.0).contains(&exposure.stops), "stops", exposure.stops, "0 to 4")?;
            let balance = exposure.white_balance;
            self.rule((0.0..=2.0).contains(&balance), "white_balance", balance, "0 to 2")?;
        }
        let turn = photographs.pose_error.unwrap_or(0.0);
        self.rule((0.0..=10.0).contains(&turn), "pose_error", turn, "0 to 10 degrees")?;
        photographs.noise.map_or(Ok(()), |noise| {
            let (full, read) = (noise.full_well, noise.read);
            self.rule((1.0..=1e9).contains(&full), "full_well", full, "1 to 1e9 electrons")?;
            self.rule((0.0..=1e6).contains(&read), "read", read, "0 to 1e6 electrons")
        })
    }
}

/// Checks every number of the lights of a scene.
pub(crate) fn check_lights(scene: &Scene) -> Result<()> {
    if let Some(sun) = &scene.sun {
        Place::new(&|| "sun".to_owned()).sun(sun)?;
    }
    for (index, lamp) in scene.lamps.iter().enumerate() {
        Place::new(&|| format!("lamp {index} ({})", lamp.name)).lamp(lamp)?;
    }
    Place::new(&|| "sky".to_owned()).sky(&scene.sky)
}

impl Photographs {
    /// Checks every number, and that the path and the lens can be used: the camera has a view at either end of the
    /// path, and the distortion has an inverse everywhere in the picture's border.
    ///
    /// # Errors
    /// The first rule that is not kept, with its field.
    pub fn check(&self) -> Result<()> {
        Place::new(&|| "photographs".to_owned()).photographs(self)?;
        for u in [0.0, 1.0] {
            self.path.camera_at(self.lens().intrinsics, u)?;
        }
        self.check_lens()
    }
}
