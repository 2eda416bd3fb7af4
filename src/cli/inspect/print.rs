use clap::ValueEnum;
use meshmend::inspect::{Fit, Inspection, NoWall, Overhang, OverhangArea, PrintMeasures};
use meshmend::scene::{Unit, UnitSource};

use super::bars::figure;
use super::defects::point;
use super::text::{Row, genus, row};

/// Sizes, and what a printer wants to know, as far as it was measured.
pub fn measures(it: &Inspection) -> Vec<Row> {
    let (m, print) = (&it.measures, it.print.as_ref());
    let scale = Scale::of(print);
    let mut list = Vec::new();
    if let Some(print) = print {
        list.push(row("unit", unit(print)));
    }
    if let Some(b) = m.bounding_box {
        list.push(row("size", scale.lengths([0, 1, 2].map(|k| b.max[k] - b.min[k]))));
        list.push(row("box", format!("{} to {}", point(b.min), point(b.max))));
    }
    list.push(row("area", scale.power(m.area, 2)));
    let volume = scale.power(m.volume.value, 3);
    list.push(row(
        "volume",
        if m.volume.reliable { volume } else { format!("{volume}, not reliable: not a closed solid") },
    ));
    let shells = &it.characteristics.shells;
    list.push(row("genus", genus(shells.genus, shells.genus_not_measurable)));
    list.extend(print.into_iter().flat_map(|print| printing(print, &scale)));
    list
}

fn unit(print: &PrintMeasures) -> String {
    let why = match print.unit_source {
        UnitSource::Declared => "as given",
        UnitSource::File => "as the file says",
        UnitSource::Assumed => "assumed; --unit says otherwise",
    };
    format!("{}, {why}", symbol(print.unit))
}

fn printing(it: &PrintMeasures, scale: &Scale) -> Vec<Row> {
    let centre = it.centre_of_mass.map_or_else(
        || "not measurable: no reliable volume".to_owned(),
        |at| {
            // What is less than rounding on the model's size is told as 0.
            let least = it.size.iter().fold(0.0f64, |most, side| most.max(*side)) * f64::EPSILON;
            point(at.map(|x| if x.abs() > least { x } else { 0.0 }))
        },
    );
    let wall = match (&it.thinnest_wall, it.no_wall) {
        (Some(wall), _) => format!(
            "{} at {}, faces {} and {}; the median is {}",
            scale.lengths([wall.thickness]),
            point(wall.at),
            wall.faces[0],
            wall.faces[1],
            figure(wall.median)
        ),
        (None, Some(NoWall::NoSurface)) => "not measurable: no surface".to_owned(),
        (None, Some(NoWall::NoOppositeSides)) => "not measurable: no two sides face away from each other".to_owned(),
        (None, Some(NoWall::NotPrintable)) => "not measured: the mesh is not printable".to_owned(),
        (None, Some(NoWall::OpenSurface) | None) => "not measurable: too open to have an inside, or a sheet".to_owned(),
    };
    let mut list = vec![row("centre of mass", centre), row("solids", it.solids), row("thinnest wall", wall)];
    list.push(row("overhang", overhang(&it.overhang, scale)));
    list.extend(it.fit.map(|fit| row("build volume", fits(fit))));
    list
}

fn overhang(it: &Overhang, scale: &Scale) -> String {
    let list = |number: &dyn Fn(&OverhangArea) -> String| it.beyond.iter().map(number).collect::<Vec<_>>().join(", ");
    let degrees = list(&|beyond| figure(beyond.degrees));
    let up = point(it.up);
    if it.beyond.iter().all(|beyond| beyond.area == 0.0) {
        return format!("none beyond {degrees} degrees; up is {up}");
    }
    let (areas, percent) = (list(&|beyond| figure(beyond.area)), list(&|beyond| format!("{:.1}", beyond.percent)));
    format!("beyond {degrees} degrees: {areas}{} ({percent} %); up is {up}", scale.suffix(2))
}

fn fits(fit: Fit) -> String {
    let room = format!("{} mm", fit.build_volume.map(figure).join(" x "));
    match (fit.as_is, fit.turned) {
        (true, _) => format!("it fits into {room}"),
        (false, true) => format!("it fits into {room} only when turned"),
        (false, false) => format!("it does not fit into {room}"),
    }
}

/// The short name of a unit, as on the command line.
fn symbol(unit: Unit) -> String {
    unit.to_possible_value().map_or_else(String::new, |value| value.get_name().to_owned())
}

/// Writes measures with their unit, where it is told.
struct Scale {
    unit: Option<Unit>,
}

impl Scale {
    fn of(print: Option<&PrintMeasures>) -> Self {
        Self { unit: print.map(|print| print.unit) }
    }

    /// Lengths, in millimetres too.
    fn lengths<const N: usize>(&self, lengths: [f64; N]) -> String {
        let text = lengths.map(figure).join(" x ");
        match self.unit {
            None => text,
            Some(Unit::Millimetre) => format!("{text} mm"),
            Some(unit) => {
                let millimetres = lengths.map(|length| figure(length * unit.millimetres())).join(" x ");
                format!("{text} {} = {millimetres} mm", symbol(unit))
            }
        }
    }

    /// An area or a volume.
    fn power(&self, value: f64, dimension: u32) -> String {
        figure(value) + &self.suffix(dimension)
    }

    fn suffix(&self, dimension: u32) -> String {
        self.unit.map_or_else(String::new, |unit| format!(" {}^{dimension}", symbol(unit)))
    }
}
