//! The command line's options that prepare a model for a printing process.

use std::path::PathBuf;

use clap::Args;
use meshmend::printing::profile::ProcessLimits;
use meshmend::repair::{Interior, Islands, PrintOptions, Voids, WallGrowth};

/// The process to check a model against.
#[derive(Debug, Args)]
pub struct ProcessArgs {
    /// Printing process to check the model against; `meshmend profiles` lists all.
    #[arg(long, env = "MESHMEND_PROCESS", value_name = "NAME")]
    process: Option<String>,
    /// JSON file with limits that replace those of the process's profile, such as `{"free_wall_mm": 1.2}`.
    #[arg(long, env = "MESHMEND_PROCESS_LIMITS", value_name = "FILE", requires = "process")]
    process_limits: Option<PathBuf>,
}

impl ProcessArgs {
    /// The name of the process, and the limits of the file.
    ///
    /// # Errors
    /// The message for a file that cannot be read.
    pub fn read(&self) -> Result<(Option<String>, Option<ProcessLimits>), String> {
        let limits = self.process_limits.as_ref().map(|path| {
            let named = |error: &dyn std::fmt::Display| format!("{}: {error}", path.display());
            let text = std::fs::read(path).map_err(|error| named(&error))?;
            serde_json::from_slice(&text).map_err(|error| named(&error))
        });
        Ok((self.process.clone(), limits.transpose()?))
    }
}

/// Options that prepare a model for a printing process.
#[derive(Debug, Args)]
pub struct PrintOptionArgs {
    #[command(flatten)]
    process: ProcessArgs,
    /// Least wall thickness in millimetres; thinner walls are thickened.
    #[arg(long, env = "MESHMEND_MIN_WALL", value_name = "MM")]
    min_wall: Option<f64>,
    /// Thicken thin walls to the limit of the process.
    #[arg(long, env = "MESHMEND_THICKEN_TO_PROCESS", requires = "process")]
    thicken_to_process: bool,
    /// Side on which thin walls grow.
    #[arg(long, env = "MESHMEND_WALL_GROWTH", value_enum, default_value_t)]
    wall_growth: WallGrowth,
    /// Treatment of the space inside a model.
    #[arg(long, env = "MESHMEND_INTERIOR", value_enum, default_value_t)]
    interior: Interior,
    /// Widest opening, in millimetres, that is sealed when the interior is filled.
    #[arg(long, env = "MESHMEND_SEAL_MM", value_name = "MM")]
    seal_mm: Option<f64>,
    /// Treatment of small separate solids.
    #[arg(long, env = "MESHMEND_ISLANDS", value_enum, default_value_t)]
    islands: Islands,
    /// Treatment of sealed cavities.
    #[arg(long, env = "MESHMEND_VOIDS", value_enum, default_value_t)]
    voids: Voids,
    /// Volume in mm³ above which sealed cavities are kept or vented; smaller ones are filled.
    #[arg(long, env = "MESHMEND_KEEP_CAVITIES_OVER_MM3", value_name = "MM3")]
    keep_cavities_over_mm3: Option<f64>,
    /// Diameter of the holes that `--voids vent` drills, in millimetres.
    #[arg(long, env = "MESHMEND_VENT_DIAMETER_MM", value_name = "MM")]
    vent_diameter_mm: Option<f64>,
    /// Height of the result in millimetres; the model is scaled evenly.
    #[arg(long, env = "MESHMEND_TARGET_HEIGHT_MM", value_name = "MM", conflicts_with = "target_longest_mm")]
    target_height_mm: Option<f64>,
    /// Longest side of the result in millimetres; the model is scaled evenly.
    #[arg(long, env = "MESHMEND_TARGET_LONGEST_MM", value_name = "MM")]
    target_longest_mm: Option<f64>,
}

impl PrintOptionArgs {
    /// The options.
    ///
    /// # Errors
    /// The message for a file of limits that cannot be read.
    pub fn options(&self) -> Result<PrintOptions, String> {
        let (process, process_limits) = self.process.read()?;
        Ok(PrintOptions {
            process,
            process_limits,
            min_wall: self.min_wall,
            thicken_to_process: self.thicken_to_process,
            wall_growth: self.wall_growth,
            interior: self.interior,
            seal_mm: self.seal_mm,
            islands: self.islands,
            voids: self.voids,
            keep_cavities_over_mm3: self.keep_cavities_over_mm3,
            vent_diameter_mm: self.vent_diameter_mm,
            target_height_mm: self.target_height_mm,
            target_longest_mm: self.target_longest_mm,
        })
    }
}
