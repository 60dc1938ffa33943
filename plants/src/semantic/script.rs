//! The edit script: one operation a line, each undoable.

use super::camera::Camera;
use super::notation::Distribution;
use super::tree::{
    ANCHOR_EDITED, ChildSet, MIN_RADIUS, NAMES, POINTS, RADIUS, RANGES, ROTATE, Style, Tree,
    point_at, radius_at,
};
use glam::{Quat, Vec2, Vec3};
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::sync::Arc;

/// What an edit script does to a tree, and what it can take back.
#[derive(Clone, Debug)]
pub struct Editor {
    state: State,
    undone: Vec<State>,
    done: Vec<State>,
}

#[derive(Clone, Debug, PartialEq)]
struct State {
    tree: Tree,
    selected: Vec<u32>,
    same_level: bool,
    recursive: bool,
    by_tag: bool,
    cameras: BTreeMap<String, Camera>,
}

/// Most branches that are kept for undo, some 300 bytes each: about a gigabyte.
const MOST_KEPT: u64 = 3_000_000;

/// Half the width of the polygon that a sweep of the mouse makes, of the picture's width.
const SWEEP: f32 = 0.003;

/// What is wrong with a line.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("line {line}: `{token}`: {what}")]
pub struct ScriptError {
    /// Line, from 1.
    pub line: usize,
    /// The word that is wrong.
    pub token: String,
    /// What is wrong with it, and what is allowed.
    pub what: String,
}

type Result<T> = std::result::Result<T, (String, String)>;

fn wrong<T>(token: &str, what: impl Into<String>) -> Result<T> {
    Err((token.into(), what.into()))
}

const OPERATIONS: &str = "tree, camera, cps, select, mode, limit, set, move, rotate, sketch, saw, delete, \
                          tag, assign, radii, undo and redo";

impl Editor {
    /// A tree that is only a trunk, which is selected.
    pub fn new(seed: u64) -> Self {
        let tree = Tree::new(seed);
        let selected = vec![0];
        let state = State {
            tree,
            selected,
            same_level: false,
            recursive: false,
            by_tag: false,
            cameras: BTreeMap::new(),
        };
        Self { state, undone: Vec::new(), done: Vec::new() }
    }

    /// A tree from elsewhere, its trunk selected.
    pub fn of(tree: Tree) -> Self {
        let mut editor = Self::new(tree.seed);
        editor.state.selected = tree.root.into_iter().collect();
        editor.state.tree = tree;
        editor
    }

    /// The tree as edited so far.
    pub fn tree(&self) -> &Tree {
        &self.state.tree
    }

    /// The branches that were picked, before the modes add to them.
    pub fn selected(&self) -> &[u32] {
        &self.state.selected
    }

    /// Runs all lines of a script and returns how many operations there were.
    ///
    /// # Errors
    /// The first line that is wrong; the lines before it have been done.
    pub fn run(&mut self, script: &str) -> std::result::Result<usize, ScriptError> {
        let mut operations = 0;
        for (index, line) in script.lines().enumerate() {
            let line = line.split_once('%').map_or(line, |(line, _)| line).trim();
            if line.is_empty() {
                continue;
            }
            self.apply(line).map_err(|(token, what)| ScriptError {
                line: index + 1,
                token,
                what,
            })?;
            operations += 1;
        }
        Ok(operations)
    }

    /// Forgets the oldest states when those that are kept grow beyond [`MOST_KEPT`].
    fn forget(&mut self) {
        let mut newer = &self.state;
        let mut kept = 0;
        let first = self.done.iter().rposition(|older| {
            // What was rebuilt is not shared between the two states; the rest is a pointer each.
            kept += newer.tree.rebuilt.saturating_sub(older.tree.rebuilt);
            kept += older.tree.branches.len() as u64 / 32;
            newer = older;
            kept > MOST_KEPT
        });
        if let Some(first) = first {
            self.done.drain(..=first);
        }
    }

    /// Does one operation; a wrong one leaves everything as it was.
    fn apply(&mut self, line: &str) -> Result<()> {
        let words: Vec<&str> = line.split_whitespace().collect();
        let (stack, other) = match words[0] {
            "undo" => (&mut self.done, &mut self.undone),
            "redo" => (&mut self.undone, &mut self.done),
            _ => {
                let mut next = self.state.clone();
                next.apply(words[0], &words[1..])?;
                self.done.push(std::mem::replace(&mut self.state, next));
                self.undone.clear();
                self.forget();
                return Ok(());
            }
        };
        let Some(state) = stack.pop() else {
            return wrong(words[0], format!("there is nothing to {}", words[0]));
        };
        other.push(std::mem::replace(&mut self.state, state));
        Ok(())
    }
}

impl State {
    fn apply(&mut self, operation: &str, words: &[&str]) -> Result<()> {
        match (operation, words) {
            ("tree", ["seed", seed]) => {
                let seed = seed.parse().or_else(|_| wrong(seed, "a seed is a whole number"))?;
                *self = Editor::new(seed).state;
                Ok(())
            }
            ("cps", [name, "on", selector, settings @ ..]) => {
                self.add_set(name, selector, settings)
            }
            ("camera", [name, "eye", eye, "target", target, "fov", fov]) => {
                let angle = number(fov)?;
                if !(1.0..=170.0).contains(&angle) {
                    return wrong(fov, "the angle of view is 1 to 170 degrees");
                }
                let camera = Camera::new(vector(eye)?, vector(target)?, angle.to_radians());
                let Some(camera) = camera else {
                    return wrong(target, "the eye and the target are the same place");
                };
                self.cameras.insert((*name).into(), camera);
                Ok(())
            }
            ("select", ["crossing", camera, from, to]) => {
                let (camera, sweep) = (self.camera(camera)?, [spot(from)?, spot(to)?]);
                let hit = |&id: &u32| {
                    let branch = self.tree.get(id);
                    camera.crosses(&branch.points, &branch.radii, sweep, SWEEP)
                };
                let found: Vec<u32> = self.tree.all().into_iter().filter(hit).collect();
                if found.is_empty() {
                    return wrong("crossing", "no branch is crossed");
                }
                self.selected = found;
                Ok(())
            }
            ("select", [selector, ..]) => {
                self.selected = self.pick(selector, words.get(1).copied())?;
                Ok(())
            }
            ("mode", [mode, state]) => {
                let on = switch(state)?;
                match *mode {
                    "same_level" => self.same_level = on,
                    "recursive" => self.recursive = on,
                    _ => return wrong(mode, "the modes are same_level and recursive"),
                }
                Ok(())
            }
            ("limit", ["tag", state]) => {
                self.by_tag = switch(state)?;
                Ok(())
            }
            ("set", ["count" | "anchor", set, value]) => self.set_children(words[0], set, value),
            ("set", settings) if !settings.is_empty() => self.set(settings),
            ("move", ["point", index, "by", by]) => self.move_point(index, vector(by)?),
            ("rotate", ["angle", by]) => self.rotate(number(by)?),
            ("sketch", ["trunk", points @ ..]) => self.sketch(None, points),
            ("sketch", ["on", id, "at", anchor, points @ ..]) => {
                let parent = self.id(id)?;
                self.sketch(Some((parent, anchor)), points)
            }
            ("sketch", ["on", id, "camera", camera, "points", count, path @ ..]) => {
                let parent = self.id(id)?;
                self.sketch_seen(parent, camera, count, path)
            }
            ("saw", ["at", at]) => {
                let cut = number(at)?;
                if !(0.01..1.0).contains(&cut) {
                    return wrong(at, "a branch is cut at 0.01 to 1 of its control points");
                }
                self.saw(|_| cut)
            }
            ("saw", ["camera", camera, at]) => {
                let (camera, at) = (self.camera(camera)?, spot(at)?);
                self.saw(|points| {
                    let seen = camera.nearest(points, at);
                    seen.map_or(0.99, |seen| seen.anchor).clamp(0.01, 0.99)
                })
            }
            ("delete", []) => self.delete(),
            ("tag", [name]) => self.each(|branch| branch.tag = Some((*name).into())),
            ("assign", [name]) => self.assign(name),
            ("radii", ["calculate"]) => self.radii(2.0),
            ("radii", ["calculate", "law", law]) => match number(law)? {
                value if (1.0..=4.0).contains(&value) => self.radii(value),
                _ => wrong(law, "the exponent of da Vinci's law lies in 1 to 4"),
            },
            _ => wrong(
                &[&[operation], words].concat().join(" "),
                format!("no such operation; there are {OPERATIONS}"),
            ),
        }
    }

    fn id(&self, text: &str) -> Result<u32> {
        let id = text.strip_prefix('#').and_then(|digits| digits.parse::<u32>().ok());
        let alive = |&id: &u32| self.tree.branches.get(id as usize).is_some_and(Option::is_some);
        id.filter(alive).map_or_else(|| wrong(text, "no living branch; write # and its number"), Ok)
    }

    fn pick(&self, selector: &str, of: Option<&str>) -> Result<Vec<u32>> {
        let all = self.tree.all();
        let found: Vec<u32> = match (selector, of) {
            ("trunk", None) => self.tree.root.into_iter().collect(),
            ("all", None) => all,
            ("level", Some(level)) => {
                let level: u8 =
                    level.parse().or_else(|_| wrong(level, "a level is a number from 0"))?;
                all.into_iter().filter(|&id| self.tree.get(id).level == level).collect()
            }
            ("tag", Some(tag)) => {
                let tagged = |&id: &u32| self.tree.get(id).tag.as_deref() == Some(tag);
                all.into_iter().filter(tagged).collect()
            }
            ("path", Some(path)) => vec![self.path(path)?],
            ("box", Some(bounds)) => {
                let (low, high) = match bounds.split_once("..") {
                    Some((low, high)) => (vector(low)?, vector(high)?),
                    None => return wrong(bounds, "a box is x,y,z..x,y,z"),
                };
                let inside = |p: &Vec3| p.cmpge(low).all() && p.cmple(high).all();
                all.into_iter().filter(|&id| self.tree.get(id).points.iter().any(inside)).collect()
            }
            (id, None) if id.starts_with('#') => vec![self.id(id)?],
            _ => {
                let allowed = "select trunk, all, #ID, level N, tag NAME, path trunk/SET/N or box";
                return wrong(selector, allowed);
            }
        };
        if found.is_empty() { wrong(selector, "selects nothing") } else { Ok(found) }
    }

    /// `trunk/SET/N/SET/N`, children counted from 0 by anchor.
    fn path(&self, path: &str) -> Result<u32> {
        let mut parts = path.split('/');
        let root = self.tree.root.filter(|_| parts.next() == Some("trunk"));
        let Some(mut id) = root else { return wrong(path, "a path begins with trunk") };
        while let Some(name) = parts.next() {
            let branch = self.tree.get(id);
            let Some(set) = branch.style.sets.iter().position(|set| &*set.name == name) else {
                let names: Vec<&str> = branch.style.sets.iter().map(|set| &*set.name).collect();
                return wrong(name, format!("the sets here are {}", names.join(", ")));
            };
            let index = parts.next().and_then(|n| n.parse::<usize>().ok());
            let mut children = branch.children.iter().copied();
            let of_set =
                children.by_ref().filter(|&child| usize::from(self.tree.get(child).set) == set);
            let Some(child) = index.and_then(|index| of_set.into_iter().nth(index)) else {
                return wrong(path, format!("after {name} comes the number of a branch"));
            };
            id = child;
        }
        Ok(id)
    }

    /// The selected branches and what the modes add, in order of ids.
    fn affected(&self) -> Result<Vec<u32>> {
        let mut found: BTreeSet<u32> = self.selected.iter().copied().collect();
        if found.is_empty() {
            return wrong("select", "nothing is selected");
        }
        if self.same_level {
            let levels: BTreeSet<u8> = found.iter().map(|&id| self.tree.get(id).level).collect();
            let all = self.tree.all().into_iter();
            found.extend(all.filter(|&id| levels.contains(&self.tree.get(id).level)));
        }
        if self.recursive {
            let picked: Vec<u32> = found.iter().copied().collect();
            for id in picked {
                // What lies below a selected branch was added with it.
                if !self.tree.get(id).parent.is_some_and(|parent| found.contains(&parent)) {
                    found.extend(self.tree.subtree(id));
                }
            }
        }
        if self.by_tag {
            let tags: Vec<_> =
                self.selected.iter().map(|&id| self.tree.get(id).tag.clone()).collect();
            found.retain(|&id| tags.contains(&self.tree.get(id).tag));
        }
        Ok(found.into_iter().collect())
    }

    /// Rebuilds the branches and what they bear, each once.
    fn rebuild(&mut self, ids: &[u32]) {
        let changed: BTreeSet<u32> = ids.iter().copied().collect();
        for &id in ids {
            let mut above = self.tree.get(id).parent;
            while let Some(parent) = above.filter(|parent| !changed.contains(parent)) {
                above = self.tree.get(parent).parent;
            }
            if above.is_none() {
                self.tree.rebuild(id);
            }
        }
    }

    fn each(&mut self, change: impl Fn(&mut super::tree::Branch)) -> Result<()> {
        for id in self.affected()? {
            change(self.tree.get_mut(id));
        }
        Ok(())
    }

    /// Changes styles of branches; those that were shared stay shared.
    fn restyle(&mut self, ids: &[u32], change: impl Fn(&mut Style)) {
        let mut changed: HashMap<*const Style, (Arc<Style>, Arc<Style>)> = HashMap::new();
        for &id in ids {
            let old = Arc::clone(&self.tree.get(id).style);
            let (_, new) = changed.entry(Arc::as_ptr(&old)).or_insert_with(|| {
                let mut new = (*old).clone();
                change(&mut new);
                (old, Arc::new(new))
            });
            self.tree.get_mut(id).style = Arc::clone(new);
        }
    }

    fn set(&mut self, settings: &[&str]) -> Result<()> {
        let settings = parameters(settings)?;
        let ids = self.affected()?;
        self.restyle(&ids, |style| {
            for &(parameter, value) in &settings {
                style.values[parameter] = value;
            }
        });
        if settings.iter().any(|&(parameter, _)| [RADIUS, MIN_RADIUS].contains(&parameter)) {
            ids.iter().for_each(|&id| self.tree.free_radii(id));
        }
        // One branch that is edited by itself keeps its parameters when others change.
        if let [one] = ids[..] {
            for &(parameter, _) in &settings {
                self.tree.get_mut(one).edited |= 1 << parameter;
            }
        }
        let turned: Vec<u32> = match settings.iter().any(|&(parameter, _)| parameter == ROTATE) {
            true => ids.iter().filter_map(|&id| self.tree.get(id).parent).collect(),
            false => Vec::new(),
        };
        // Siblings that follow turn too.
        let changed: BTreeSet<u32> = ids.into_iter().chain(turned.iter().copied()).collect();
        for parent in turned.into_iter().collect::<BTreeSet<_>>() {
            self.tree.turn_children(parent);
        }
        self.rebuild(&changed.into_iter().collect::<Vec<_>>());
        Ok(())
    }

    fn set_children(&mut self, what: &str, name: &str, value: &str) -> Result<()> {
        let value =
            ranged(what, value, if what == "count" { [0.0, 10_000.0] } else { [0.0, 1.0] })?;
        let mut ids = self.affected()?;
        ids.retain(|&id| self.tree.get(id).style.sets.iter().any(|set| &*set.name == name));
        if ids.is_empty() {
            return wrong(name, "no selected branch has a child parameter set of this name");
        }
        self.restyle(&ids, |style| {
            for set in style.sets.iter_mut().filter(|set| &*set.name == name) {
                *(if what == "count" { &mut set.count } else { &mut set.anchor }) = value;
            }
        });
        self.populate(&ids)
    }

    fn populate(&mut self, ids: &[u32]) -> Result<()> {
        for &id in ids {
            // A removed parent takes its children along.
            if self.tree.branches[id as usize].is_some() {
                self.tree.populate(id).or_else(|what| wrong("count", what))?;
            }
        }
        let alive = |id: &u32| self.tree.branches[*id as usize].is_some();
        let ids: Vec<u32> = ids.iter().copied().filter(alive).collect();
        self.selected.retain(|&id| self.tree.branches[id as usize].is_some());
        self.rebuild(&ids);
        Ok(())
    }

    fn add_set(&mut self, name: &str, selector: &str, settings: &[&str]) -> Result<()> {
        let (selector, of) = match selector.split_once(':') {
            Some((kind, of)) => (kind, Some(of)),
            None => (selector, None),
        };
        let ids = self.pick(selector, of)?;
        let mut set = ChildSet {
            name: name.into(),
            count: Distribution::constant(0.0),
            anchor: Distribution { from: [0.2, 0.0], to: Some([1.0, 0.0]) },
            child: Arc::default(),
        };
        let mut own = Vec::new();
        for pair in settings.chunks(2) {
            match *pair {
                ["count", value] => set.count = ranged("count", value, [0.0, 10_000.0])?,
                ["anchor", value] => set.anchor = ranged("anchor", value, [0.0, 1.0])?,
                _ => own.extend_from_slice(pair),
            }
        }
        for (parameter, value) in parameters(&own)? {
            Arc::make_mut(&mut set.child).values[parameter] = value;
        }
        let taken = |&id: &u32| self.tree.get(id).style.sets.iter().any(|set| &*set.name == name);
        if ids.iter().any(taken) {
            return wrong(name, "there is such a set already; change it by `set count` and `set`");
        }
        if ids
            .iter()
            .any(|&id| self.tree.get(id).style.sets.len() >= 255 || self.tree.get(id).level >= 30)
        {
            return wrong(name, "a branch has at most 255 sets, a tree 30 levels");
        }
        self.restyle(&ids, |style| style.sets.push(set.clone()));
        self.populate(&ids)
    }

    fn move_point(&mut self, index: &str, by: Vec3) -> Result<()> {
        let ids = self.affected()?;
        let Ok(index) = index.parse::<usize>() else {
            return wrong(index, "control points are numbered from 0");
        };
        let most = ids.iter().map(|&id| self.tree.get(id).points.len()).min().unwrap_or(0);
        if index >= most {
            return wrong(&index.to_string(), format!("the last control point is {}", most - 1));
        }
        for &id in &ids {
            let mut points = self.tree.get(id).points.to_vec();
            points[index..].iter_mut().for_each(|point| *point += by);
            if index == 0 && self.tree.root == Some(id) {
                self.tree.foot += by;
            }
            if let (0, Some(parent)) = (index, self.tree.get(id).parent) {
                let anchor = nearest(&self.tree.get(parent).points, points[0]);
                let branch = self.tree.get_mut(id);
                branch.anchor = anchor;
                branch.edited |= ANCHOR_EDITED;
            }
            self.tree.reshape(id, &points);
        }
        self.rebuild(&ids);
        Ok(())
    }

    fn rotate(&mut self, by: f32) -> Result<()> {
        let ids = self.affected()?;
        for &id in &ids {
            let points = self.tree.get(id).points.to_vec();
            let branch = self.tree.get(id);
            let tangent = branch
                .parent
                .map_or(Vec3::Z, |parent| point_at(&self.tree.get(parent).points, branch.anchor).1);
            let first = (points[1] - points[0]).normalize_or(Vec3::Z);
            let axis = tangent.cross(first).try_normalize();
            let turn = Quat::from_axis_angle(
                axis.unwrap_or_else(|| tangent.any_orthonormal_vector()),
                by.to_radians(),
            );
            let turned: Vec<Vec3> =
                points.iter().map(|&p| points[0] + turn * (p - points[0])).collect();
            self.tree.reshape(id, &turned);
        }
        self.rebuild(&ids);
        Ok(())
    }

    fn sketch(&mut self, on: Option<(u32, &str)>, points: &[&str]) -> Result<()> {
        let places = points.iter().map(|text| vector(text)).collect::<Result<Vec<_>>>()?;
        match on {
            None if self.tree.root.is_some() => {
                wrong("trunk", "there is a trunk; delete it before sketching another")
            }
            None => self.draw(None, places),
            Some((parent, anchor)) => {
                let value = ranged("anchor", anchor, [0.0, 1.0])?.from[0];
                self.draw(Some((parent, value)), places)
            }
        }
    }

    /// Adds a branch through places that are moved to begin on the parent.
    fn draw(&mut self, on: Option<(u32, f32)>, mut places: Vec<Vec3>) -> Result<()> {
        if !(2..=64).contains(&places.len()) {
            return wrong("sketch", "a branch has 2 to 64 points x,y,z");
        }
        if places.windows(2).any(|pair| pair[0].distance(pair[1]) < 1e-4) {
            return wrong("sketch", "points lie less than 0.1 mm apart");
        }
        let (parent, anchor) = (on.map(|(parent, _)| parent), on.map_or(0.0, |(_, at)| at));
        let start =
            parent.map_or(self.tree.foot, |id| point_at(&self.tree.get(id).points, anchor).0);
        let by = start - places[0];
        places.iter_mut().for_each(|place| *place += by);
        let id = self.tree.graft(parent, anchor, &places);
        self.selected = vec![id];
        self.rebuild(&[id]);
        Ok(())
    }

    fn camera(&self, name: &str) -> Result<Camera> {
        let names: Vec<&str> = self.cameras.keys().map(String::as_str).collect();
        let unknown = || wrong(name, format!("no such camera; there are: {}", names.join(", ")));
        self.cameras.get(name).copied().map_or_else(unknown, Ok)
    }

    /// Draws a branch along a path of the mouse, in the plane of the picture through its start.
    fn sketch_seen(&mut self, id: u32, camera: &str, count: &str, path: &[&str]) -> Result<()> {
        let camera = self.camera(camera)?;
        let wanted = count.parse().ok().filter(|count| (2..=64).contains(count));
        let Some(count) = wanted else {
            return wrong(count, "a branch has 2 to 64 control points");
        };
        let path = path.iter().map(|text| spot(text)).collect::<Result<Vec<Vec2>>>()?;
        let [first, _, ..] = path[..] else {
            return wrong("sketch", "a path has at least two places x,y");
        };
        let points = &self.tree.get(id).points;
        let Some(seen) = camera.nearest(points, first) else {
            return wrong("sketch", "the parent is behind the camera");
        };
        let start = point_at(points, seen.anchor).0;
        // Control points are taken at equal steps of the recorded path.
        let along = |i: usize| {
            let at = (i * (path.len() - 1)) as f32 / (count - 1) as f32;
            let k = (at as usize).min(path.len() - 2);
            camera.in_plane(path[k].lerp(path[k + 1], at - k as f32), start)
        };
        self.draw(Some((id, seen.anchor)), (0..count).map(along).collect())
    }

    fn saw(&mut self, cut_of: impl Fn(&[Vec3]) -> f32) -> Result<()> {
        let ids = self.affected()?;
        for &id in &ids {
            if self.tree.branches[id as usize].is_none() {
                continue;
            }
            let branch = self.tree.get(id);
            let cut = cut_of(&branch.points);
            let (end, _) = point_at(&branch.points, cut);
            let j = cut * (branch.points.len() - 1) as f32;
            let mut points = branch.points[..j.ceil() as usize].to_vec();
            let mut radii = branch.radii[..points.len()].to_vec();
            radii.push(radius_at(&branch.radii, cut));
            points.push(end);
            for child in branch.children.clone() {
                let anchor = self.tree.get(child).anchor;
                if anchor > cut {
                    self.tree.remove(child);
                    continue;
                }
                let kept = nearest(&points, point_at(&self.tree.get(id).points, anchor).0);
                let child = self.tree.get_mut(child);
                child.anchor = kept;
                child.edited |= ANCHOR_EDITED;
            }
            self.tree.recount(id);
            let branch = self.tree.get_mut(id);
            let style = Arc::make_mut(&mut branch.style);
            style.values[POINTS] = Distribution::constant(points.len() as f32);
            branch.edited |= 1 << POINTS;
            self.tree.keep_radii(id, radii.into());
            self.tree.reshape(id, &points);
        }
        let alive = |id: &u32| self.tree.branches[*id as usize].is_some();
        let ids: Vec<u32> = ids.into_iter().filter(alive).collect();
        self.selected.retain(|&id| self.tree.branches[id as usize].is_some());
        self.rebuild(&ids);
        Ok(())
    }

    fn delete(&mut self) -> Result<()> {
        for id in self.affected()? {
            if self.tree.branches[id as usize].is_none() {
                continue;
            }
            let parent = self.tree.get(id).parent;
            self.tree.remove(id);
            if let Some(parent) = parent {
                self.tree.recount(parent);
            }
        }
        self.selected.clear();
        Ok(())
    }

    fn assign(&mut self, name: &str) -> Result<()> {
        for id in self.affected()? {
            let Some(parent) = self.tree.get(id).parent else {
                return wrong(name, "the trunk belongs to no child parameter set");
            };
            let sets = &self.tree.get(parent).style.sets;
            let Some(set) = sets.iter().position(|set| &*set.name == name) else {
                let names: Vec<&str> = sets.iter().map(|set| &*set.name).collect();
                return wrong(name, format!("the parent's sets are {}", names.join(", ")));
            };
            self.tree.get_mut(id).set = set as u8;
            self.tree.recount(parent);
        }
        Ok(())
    }

    fn radii(&mut self, law: f32) -> Result<()> {
        for id in self.affected()? {
            self.tree.calculate_radii(id, law);
        }
        Ok(())
    }
}

/// Anchor of the point of a polygon that is nearest to `place`.
pub(super) fn nearest(points: &[Vec3], place: Vec3) -> f32 {
    let on_segment = |(k, pair): (usize, &[Vec3])| {
        let along = pair[1] - pair[0];
        let u = (place - pair[0]).dot(along) / along.length_squared().max(f32::MIN_POSITIVE);
        let u = u.clamp(0.0, 1.0);
        ((pair[0] + u * along).distance(place), (k as f32 + u) / (points.len() - 1) as f32)
    };
    let all = points.windows(2).enumerate().map(on_segment);
    all.min_by(|a, b| a.0.total_cmp(&b.0)).map_or(0.0, |(_, anchor)| anchor)
}

/// Pairs of names and values.
fn parameters(words: &[&str]) -> Result<Vec<(usize, Distribution)>> {
    let one = |pair: &[&str]| {
        let [name, value] = *pair else { return wrong(pair[0], "has no value") };
        let Some(parameter) = NAMES.iter().position(|known| *known == name) else {
            return wrong(name, format!("no such parameter; there are {}", NAMES.join(", ")));
        };
        Ok((parameter, ranged(name, value, RANGES[parameter])?))
    };
    words.chunks(2).map(one).collect()
}

fn ranged(name: &str, text: &str, [low, high]: [f32; 2]) -> Result<Distribution> {
    let value: Distribution =
        text.parse().or_else(|what| wrong(text, format!("{name}: {what}")))?;
    let [least, most] = value.bounds();
    // What chance carries over the edge of a range is cut; the means must lie inside.
    let means = [value.from[0], value.to.unwrap_or(value.from)[0]];
    if means.iter().any(|mean| !(low..=high).contains(mean))
        || !(least.is_finite() && most.is_finite())
    {
        return wrong(text, format!("{name} lies in {low} to {high}"));
    }
    Ok(value)
}

fn switch(text: &str) -> Result<bool> {
    match text {
        "on" => Ok(true),
        "off" => Ok(false),
        _ => wrong(text, "write on or off"),
    }
}

fn number(text: &str) -> Result<f32> {
    let value = text.parse::<f32>().ok().filter(|value| value.abs() < 1e6);
    value.map_or_else(|| wrong(text, "is not a number"), Ok)
}

fn vector(text: &str) -> Result<Vec3> {
    let parts = text.split(',').map(number).collect::<Result<Vec<_>>>()?;
    match parts[..] {
        [x, y, z] => Ok(Vec3::new(x, y, z)),
        _ => wrong(text, "a vector is x,y,z"),
    }
}

fn spot(text: &str) -> Result<Vec2> {
    let parts = text.split(',').map(number).collect::<Result<Vec<_>>>()?;
    match parts[..] {
        [x, y] => Ok(Vec2::new(x, y)),
        _ => wrong(text, "a place in a picture is x,y, both 0 to 1 from its upper left"),
    }
}
