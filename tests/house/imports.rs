//! Which files of the crate import from which, followed through re-exports to the file that defines an item.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use petgraph::algo::tarjan_scc;
use petgraph::graph::DiGraph;
use syn::visit::Visit;

/// The names from the crate's root to a module or an item in it.
type Names = Vec<String>;

/// A file's own items and its imports.
#[derive(Default)]
struct Module {
    file: PathBuf,
    items: BTreeSet<String>,
    /// The paths that each imported name stands for; `*` for glob imports.
    imports: BTreeMap<String, Vec<Names>>,
    /// Paths in the code itself.
    paths: Vec<Names>,
}

/// Groups of files that import each other in a circle.
pub fn cycles(source: &Path, files: &[PathBuf]) -> Vec<Vec<PathBuf>> {
    circles(imports(source, files))
}

/// Groups of neighbours in a folder that import each other in a circle. `a.rs` and all files in `a/` count as one neighbour.
pub fn cycles_of_neighbours(source: &Path, files: &[PathBuf]) -> Vec<Vec<PathBuf>> {
    circles(imports(source, files).iter().filter_map(|(from, to)| neighbours(from, to)).collect())
}

/// The files or folders without extension that hold two files and have the same parent. None if both files are in one of them, and for
/// `mod.rs`, `lib.rs` and `main.rs`, which belong to the parent.
fn neighbours(from: &Path, to: &Path) -> Option<(PathBuf, PathBuf)> {
    let folder = from.ancestors().find(|folder| to.starts_with(folder))?;
    let within = |file: &Path| {
        let name = Path::new(file.strip_prefix(folder).ok()?.iter().next()?).with_extension("");
        (!["mod", "lib", "main"].map(Path::new).contains(&&*name)).then(|| folder.join(name))
    };
    let pair = (within(from)?, within(to)?);
    (pair.0 != pair.1).then_some(pair)
}

/// Groups of paths that lead to each other in a circle.
fn circles(imports: BTreeSet<(PathBuf, PathBuf)>) -> Vec<Vec<PathBuf>> {
    let mut graph = DiGraph::<PathBuf, ()>::new();
    let mut nodes = BTreeMap::new();
    for (from, to) in imports {
        let [from, to] = [from, to].map(|path| *nodes.entry(path.clone()).or_insert_with(|| graph.add_node(path)));
        graph.update_edge(from, to, ());
    }
    let circles = tarjan_scc(&graph).into_iter().filter(|circle| circle.len() > 1);
    circles.map(|circle| circle.into_iter().map(|node| graph[node].clone()).collect()).collect()
}

/// Each pair of files of which the first imports an item that the second defines.
pub fn imports(source: &Path, files: &[PathBuf]) -> BTreeSet<(PathBuf, PathBuf)> {
    let modules: BTreeMap<Names, Module> =
        files.iter().map(|file| (names_of(source, file), Module::read(file))).collect();
    let mut pairs = BTreeSet::new();
    for (names, module) in &modules {
        // The import of a module itself uses no item; the paths that begin with the module's name do.
        let is_module = |path: &Names| absolute(&modules, names, path).is_some_and(|path| modules.contains_key(&path));
        let items = module.imports.iter().filter(|(name, _)| *name != "*").flat_map(|(_, paths)| paths);
        let items = items.filter(|path| !is_module(path)).chain(module.imports.get("*").into_iter().flatten());
        for path in items.chain(&module.paths) {
            let defined = absolute(&modules, names, path).and_then(|path| definition(&modules, &path, 0));
            if let Some(other) = defined.filter(|other| *other != names) {
                pairs.insert((module.file.clone(), modules[other].file.clone()));
            }
        }
    }
    pairs
}

/// `src/mesh/edges.rs` is `mesh::edges`, `src/mesh/mod.rs` is `mesh`. Without a `lib.rs`, `main.rs` is the root.
fn names_of(source: &Path, file: &Path) -> Names {
    let path = file.strip_prefix(source).unwrap().with_extension("");
    let names: Names = path.iter().map(|name| name.to_str().unwrap().to_owned()).collect();
    match names.last().map(String::as_str) {
        Some("mod" | "lib") => names[..names.len() - 1].to_vec(),
        Some("main") if names.len() == 1 && !source.join("lib.rs").exists() => Names::new(),
        _ => names,
    }
}

/// Resolves a path in a module to one from the crate's root; none if it leads to another crate.
fn absolute(modules: &BTreeMap<Names, Module>, module: &Names, path: &Names) -> Option<Names> {
    let ups = path.iter().take_while(|name| *name == "super").count();
    let (base, rest) = match path.first().map(String::as_str) {
        Some("crate") => (&[][..], &path[1..]),
        Some("self") => (&module[..], &path[1..]),
        Some("super") => (&module[..module.len().checked_sub(ups)?], &path[ups..]),
        Some(first) => {
            let child = [&module[..], &[first.to_owned()]].concat();
            let is_local = modules.contains_key(&child) || modules[module].imports.contains_key(first);
            is_local.then_some((&module[..], &path[..]))?
        }
        None => return None,
    };
    Some([base, rest].concat())
}

/// The module whose file defines the item at a path from the root; none for items of another crate.
fn definition<'a>(modules: &'a BTreeMap<Names, Module>, path: &Names, depth: usize) -> Option<&'a Names> {
    let length = (0..=path.len()).rev().find(|&length| modules.contains_key(&path[..length]))?;
    let (names, module) = modules.get_key_value(&path[..length])?;
    let Some(name) = path.get(length) else { return Some(names) };
    if module.items.contains(name) || depth > 8 {
        return Some(names);
    }
    let follow = |import: &Names, rest: &[String]| {
        let target = absolute(modules, names, import)?;
        definition(modules, &[&target[..], rest].concat(), depth + 1)
    };
    if let Some(imports) = module.imports.get(name) {
        return imports.iter().find_map(|import| follow(import, &path[length + 1..]));
    }
    let all = module.imports.get("*").into_iter().flatten();
    all.into_iter().find_map(|import| {
        let found = follow(import, &path[length..])?;
        modules[found].items.contains(name).then_some(found)
    })
}

impl Module {
    fn read(file: &Path) -> Self {
        let text = std::fs::read_to_string(file).unwrap();
        let mut module = Self { file: file.to_owned(), ..Self::default() };
        module.visit_file(&syn::parse_file(&text).unwrap());
        module
    }

    fn import(&mut self, before: &Names, tree: &syn::UseTree) {
        let with = |name: &syn::Ident| [&before[..], &[name.to_string()]].concat();
        let (name, path) = match tree {
            syn::UseTree::Path(path) => return self.import(&with(&path.ident), &path.tree),
            syn::UseTree::Group(group) => return group.items.iter().for_each(|item| self.import(before, item)),
            syn::UseTree::Glob(_) => ("*".to_owned(), before.clone()),
            syn::UseTree::Rename(rename) => (rename.rename.to_string(), with(&rename.ident)),
            syn::UseTree::Name(name) if name.ident == "self" => (before.last().unwrap().clone(), before.clone()),
            syn::UseTree::Name(name) => (name.ident.to_string(), with(&name.ident)),
        };
        self.imports.entry(name).or_default().push(path);
    }
}

impl<'ast> Visit<'ast> for Module {
    fn visit_item(&mut self, item: &'ast syn::Item) {
        let (attributes, name) = match item {
            syn::Item::Mod(item) => (&item.attrs, None),
            syn::Item::Fn(item) => (&item.attrs, Some(&item.sig.ident)),
            syn::Item::Struct(item) => (&item.attrs, Some(&item.ident)),
            syn::Item::Enum(item) => (&item.attrs, Some(&item.ident)),
            syn::Item::Trait(item) => (&item.attrs, Some(&item.ident)),
            syn::Item::Type(item) => (&item.attrs, Some(&item.ident)),
            syn::Item::Const(item) => (&item.attrs, Some(&item.ident)),
            syn::Item::Static(item) => (&item.attrs, Some(&item.ident)),
            _ => return syn::visit::visit_item(self, item),
        };
        let is_test = |attribute: &syn::Attribute| {
            attribute.path().is_ident("cfg")
                && attribute.parse_args::<syn::Path>().is_ok_and(|path| path.is_ident("test"))
        };
        if !attributes.iter().any(is_test) {
            self.items.extend(name.map(ToString::to_string));
            syn::visit::visit_item(self, item);
        }
    }

    fn visit_item_use(&mut self, item: &'ast syn::ItemUse) {
        self.import(&Names::new(), &item.tree);
    }

    /// The path in `pub(in path)` imports nothing.
    fn visit_vis_restricted(&mut self, _: &'ast syn::VisRestricted) {}

    fn visit_path(&mut self, path: &'ast syn::Path) {
        if path.segments.len() > 1 {
            self.paths.push(path.segments.iter().map(|segment| segment.ident.to_string()).collect());
        }
        syn::visit::visit_path(self, path);
    }
}
