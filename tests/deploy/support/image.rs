//! The Dockerfile, parsed.

use std::collections::BTreeMap;

use super::source::text;

/// Instructions of the Dockerfile, each with the rest of its line.
pub struct Image(Vec<(String, String)>);

impl Image {
    /// The image with Blender, which is the default.
    pub fn read() -> Self {
        Self::stage("full")
    }

    /// One stage of the build.
    pub fn stage(name: &str) -> Self {
        let mut stage = String::new();
        let instructions = Self::whole().0.into_iter().filter(|(instruction, rest)| {
            if instruction == "FROM" {
                stage = rest.rsplit_once(" AS ").expect("a stage with a name").1.to_owned();
            }
            stage == name
        });
        Self(instructions.collect())
    }

    /// All stages.
    pub fn whole() -> Self {
        let text = text("docker/Dockerfile");
        let lines: Vec<_> = text.lines().filter(|line| !line.starts_with('#')).collect();
        let joined = lines.join("\n").replace("\\\n", " ");
        let instructions = joined.lines().filter_map(|line| line.trim().split_once(' '));
        Self(instructions.map(|(name, rest)| (name.to_owned(), rest.trim().to_owned())).collect())
    }

    /// The arguments of each instruction with that name.
    pub fn all(&self, name: &str) -> Vec<&str> {
        self.0.iter().filter(|(instruction, _)| instruction == name).map(|(_, rest)| rest.as_str()).collect()
    }

    pub fn list(&self, name: &str) -> Vec<String> {
        serde_json::from_str(self.all(name).last().expect("an instruction")).expect("a list")
    }

    pub fn variables(&self) -> BTreeMap<String, String> {
        let pairs = self.all("ENV").into_iter().flat_map(str::split_whitespace);
        pairs.filter_map(|pair| pair.split_once('=')).map(|(name, value)| (name.to_owned(), value.to_owned())).collect()
    }

    /// The user and group ids.
    pub fn user(&self) -> Vec<u64> {
        self.all("USER")[0].split(':').map(|id| id.parse().expect("a number")).collect()
    }

    /// The paths of the repository that the image copies.
    pub fn sources(&self) -> Vec<&str> {
        let copies = self.all("COPY").into_iter().filter(|rest| !rest.starts_with("--from"));
        copies.flat_map(|rest| rest.rsplit_once(' ').expect("from and to").0.split_whitespace()).collect()
    }
}
