"""codemod.py ROOT types.pickle MAP.tsv... [--apply] [--report F]: rename by qualified name."""
import ast, sys, glob, pickle, re, subprocess, tokenize, io, os
from collections import defaultdict
from pathlib import Path
args = [a for a in sys.argv[1:] if not a.startswith("--")]
APPLY = "--apply" in sys.argv
root = Path(args[0]).resolve()
TYPES = pickle.load(open(args[1], "rb"))
troot = None
for f in TYPES:
    m = re.match(r"(.*?)/(src|tests|docs)/", f); troot = m.group(1); break
ROOTS = sorted(glob.glob(str(root / "src/*/src"))) + [str(root / "tests/benchmarks"), str(root / "tests"), str(root)]
def modname(f):
    for r in ROOTS:
        if f.startswith(r + "/"):
            n = f[len(r) + 1:]
            n = n[:-3] if n.endswith(".py") else n
            return n.replace("/", ".").removesuffix(".__init__")
tracked = subprocess.run(["git", "-C", str(root), "ls-files", "-z"], capture_output=True, text=True).stdout.split("\0")
tracked = [str(root / f) for f in tracked if f and (root / f).is_file() and not (root / f).is_symlink()]
def is_py(f):
    if f.endswith(".py"): return True
    if Path(f).suffix: return False
    try: return b"python" in open(f, "rb").readline()[:60]
    except OSError: return False
PY = [f for f in tracked if is_py(f) and "/upstream_" not in f]
# ---------------------------------------------------------------- map
R = {}          # qual -> new name (last component)
KIND = {}
MODS = {}
problems = []
for m in args[2:]:
    for i, line in enumerate(open(m), 1):
        line = line.split("#")[0].rstrip() if not line.startswith("#") else ""
        if not line.strip(): continue
        p = [x.strip() for x in line.split("\t") if x.strip()]
        if len(p) != 3: problems.append(f"{m}:{i}: {line}"); continue
        k, old, new = p
        if k == "module": MODS[old] = new
        else:
            if old in R and R[old] != new: problems.append(f"twice {old}: {R[old]} {new}")
            if not new.isidentifier(): problems.append(f"not a name: {old} {new}"); continue
            R[old] = new; KIND[old] = k
def newmod(mod):
    """new dotted path of a module (longest prefix in MODS)."""
    parts = mod.split(".")
    for n in range(len(parts), 0, -1):
        pre = ".".join(parts[:n])
        if pre in MODS: return ".".join([MODS[pre]] + parts[n:])
    return mod
# ---------------------------------------------------------------- parse
class Mod: pass
mods = {}
for f in PY:
    try: text = open(f, encoding="utf-8").read(); tree = ast.parse(text)
    except (SyntaxError, UnicodeDecodeError) as e: problems.append(f"{f}: {e}"); continue
    m = Mod(); m.file = f; m.text = text; m.tree = tree; m.name = modname(f); m.is_pkg = f.endswith("__init__.py")
    m.lines = text.encode().split(b"\n"); m.bind = {}; m.edits = {}
    mods[m.name] = m
byfile = {m.file: m for m in mods.values()}
PKGS = set()
for n in mods:
    p = n.split(".")
    for i in range(1, len(p) + 1): PKGS.add(".".join(p[:i]))
def absolute(m, level, module):
    if level == 0: return module or ""
    base = m.name.split(".")
    if not m.is_pkg: base = base[:-1]
    if level > 1: base = base[:-(level - 1)]
    return ".".join(base + ([module] if module else []))
class B:  # binding
    __slots__ = ("qual", "direct")
    def __init__(s, qual, direct=True): s.qual = qual; s.direct = direct
def bind_import(m, node, out):
    if isinstance(node, ast.Import):
        for a in node.names:
            if a.asname: out[a.asname] = B(a.name, False)
            else: out[a.name.split(".")[0]] = B(a.name.split(".")[0])
    else:
        base = absolute(m, node.level, node.module)
        for a in node.names:
            if a.name == "*": continue
            out[a.asname or a.name] = B(base + "." + a.name, a.asname is None or a.asname == a.name)
def stmts(body):
    for s in body:
        yield s
        for fld in ("body", "orelse", "finalbody"):
            if not isinstance(s, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef, ast.Lambda)):
                yield from stmts(getattr(s, fld, []) or [])
        for h in getattr(s, "handlers", []) or []: yield from stmts(h.body)
        for c in getattr(s, "cases", []) or []: yield from stmts(c.body)
def target_names(t):
    if isinstance(t, ast.Name): yield t.id
    elif isinstance(t, (ast.Tuple, ast.List)):
        for e in t.elts: yield from target_names(e)
    elif isinstance(t, ast.Starred): yield from target_names(t.value)
def collect(m, body, prefix, out, local=False):
    """bindings of a scope."""
    for s in stmts(body):
        if isinstance(s, (ast.Import, ast.ImportFrom)): bind_import(m, s, out)
        elif isinstance(s, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)): out[s.name] = B(prefix + "." + s.name)
        else:
            ts = []
            if isinstance(s, ast.Assign): ts = s.targets
            elif isinstance(s, (ast.AnnAssign, ast.AugAssign)): ts = [s.target]
            elif isinstance(s, (ast.For, ast.AsyncFor)): ts = [s.target]
            elif isinstance(s, (ast.With, ast.AsyncWith)): ts = [i.optional_vars for i in s.items if i.optional_vars]
            for t in ts:
                for n in target_names(t):
                    if n not in out or not local: out.setdefault(n, B(prefix + "." + n))
        if isinstance(s, ast.Try):
            for h in s.handlers:
                if h.name: out.setdefault(h.name, B(prefix + "." + h.name))
        # walrus, match captures
        if not isinstance(s, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)):
            for fld, v in ast.iter_fields(s):
                if fld in ("body", "orelse", "finalbody", "handlers", "cases"): continue
                for e in (v if isinstance(v, list) else [v]):
                    if isinstance(e, ast.AST):
                        for w in ast.walk(e):
                            if isinstance(w, ast.NamedExpr): out.setdefault(w.target.id, B(prefix + "." + w.target.id))
        if isinstance(s, ast.Match):
            for c in s.cases:
                for w in ast.walk(c.pattern):
                    n = getattr(w, "name", None)
                    if isinstance(n, str): out.setdefault(n, B(prefix + "." + n))
for m in mods.values():
    collect(m, m.tree.body, m.name, m.bind)
    if m.is_pkg:  # lazy exports
        for s in ast.walk(m.tree):
            if isinstance(s, ast.Dict):
                for k, v in zip(s.keys, s.values):
                    if isinstance(k, ast.Constant) and isinstance(v, ast.Constant) and isinstance(v.value, str) and v.value.startswith(".") and isinstance(k.value, str):
                        m.bind.setdefault(k.value, B(m.name + v.value + "." + k.value))
def canon(q, depth=0):
    """follow imports to the definition."""
    if depth > 12: return q
    if q in mods or q in PKGS: return q
    parts = q.split(".")
    for n in range(len(parts) - 1, 0, -1):
        mod = ".".join(parts[:n])
        if mod in mods:
            b = mods[mod].bind.get(parts[n])
            if b is None: return q
            if b.qual == ".".join(parts[:n + 1]): return q
            return canon(".".join([b.qual] + parts[n + 1:]), depth + 1)
    return q
def fromkeys(m):
    """(names, place) of dict.fromkeys(names, place) in a package's __init__."""
    tuples = {t.id: s.value for s in m.tree.body if isinstance(s, ast.Assign) for t in s.targets if isinstance(t, ast.Name) and isinstance(s.value, ast.Tuple)}
    for n in ast.walk(m.tree):
        if isinstance(n, ast.Call) and isinstance(n.func, ast.Attribute) and n.func.attr == "fromkeys" and len(n.args) == 2 and isinstance(n.args[1], ast.Constant):
            t = n.args[0] if isinstance(n.args[0], ast.Tuple) else tuples.get(getattr(n.args[0], "id", ""))
            if t is not None: yield t, n.args[1].value
for m in mods.values():
    if m.is_pkg:
        for t, place in fromkeys(m):
            for e in t.elts: m.bind.setdefault(e.value, B((m.name + place if place.startswith(".") else place) + "." + e.value))
# ---------------------------------------------------------------- classes
CLS = {}   # qual -> (ClassDef, module, [base quals])
def find_classes(m, body, prefix, scopes):
    for s in stmts(body):
        if isinstance(s, ast.ClassDef):
            q = prefix + "." + s.name
            bases = []
            for b in s.bases:
                if isinstance(b, ast.Subscript): b = b.value
                x = dotted(b)
                if x:
                    first, *rest = x.split(".")
                    for sc in [*reversed(scopes), m.bind]:
                        if first in sc: bases.append(canon(".".join([sc[first].qual, *rest]))); break
            CLS[q] = (s, m, bases)
            find_classes(m, s.body, q, scopes)
        elif isinstance(s, (ast.FunctionDef, ast.AsyncFunctionDef)):
            q = prefix + "." + s.name
            loc = {}; collect(m, s.body, q, loc, True)
            find_classes(m, s.body, q, [*scopes, loc])
def dotted(e):
    if isinstance(e, ast.Name): return e.id
    if isinstance(e, ast.Attribute):
        b = dotted(e.value); return b and b + "." + e.attr
    return None
for m in mods.values(): find_classes(m, m.tree.body, m.name, [])
def mro(q, seen=None):
    seen = [] if seen is None else seen
    if q in seen or q not in CLS: return seen
    seen.append(q)
    for b in CLS[q][2]: mro(b, seen)
    return seen
SUBS = defaultdict(set)
for q in CLS:
    for b in mro(q)[1:]: SUBS[b].add(q)
def lookup(cls, name):
    """new name of attribute `name` of a class, or None."""
    for c in mro(cls):
        if c + "." + name in R: return R[c + "." + name]
    return None
USED = set()
def lookup_used(cls, name):
    for c in mro(cls):
        if c + "." + name in R: USED.add(c + "." + name); return R[c + "." + name]
    return None
# names that are attributes/methods: name -> set of new names; definitions not renamed -> include None
DEFS = defaultdict(set)  # attr name -> {new or None}
for q, (node, m, b) in CLS.items():
    names = set()
    for s in node.body:
        if isinstance(s, (ast.FunctionDef, ast.AsyncFunctionDef)): names.add(s.name)
        elif isinstance(s, ast.AnnAssign) and isinstance(s.target, ast.Name): names.add(s.target.id)
        elif isinstance(s, ast.Assign): names.update(n for t in s.targets for n in target_names(t))
    for w in ast.walk(node):
        if isinstance(w, ast.Attribute) and isinstance(w.ctx, ast.Store) and isinstance(w.value, ast.Name) and w.value.id == "self": names.add(w.attr)
    for n in names: DEFS[n].add(lookup(q, n))
for m in mods.values():
    for n, b in m.bind.items():
        if b.qual == m.name + "." + n: DEFS[n].add(R.get(b.qual))
        elif canon(b.qual) in R: DEFS[n].add(R[canon(b.qual)])
FOREIGN = set()  # attribute names that exist on types outside of the project
for f, (rec, calls) in TYPES.items():
    for name, full, own in rec.values():
        if own:
            for cls, definers, mr in own:
                if definers and not any(d.startswith(("aras_", "unit.", "truth", "faults")) for d in definers) : FOREIGN.add(name)
def unique(name):
    """the new name where every definition of the name gets it and no outside type has the name."""
    s = DEFS.get(name, set())
    if name in {"Resolver", "_type", "elements", "least_squares", "schema", "solve", "symbol", "fresh"}: return None
    if len(s) == 1 and None not in s and name not in FOREIGN: return next(iter(s))
    return None
unresolved = defaultdict(list)
# ---------------------------------------------------------------- edits
FSTR = []
def edit(m, line, col, old, new):
    """line 1-based, col in bytes."""
    if old == new: return
    got = m.lines[line - 1][col:col + len(old.encode())] if line <= len(m.lines) else b""
    before = m.lines[line - 1][col - 1:col] if line <= len(m.lines) and col > 0 else b""
    after = m.lines[line - 1][col + len(old.encode()):][:1] if line <= len(m.lines) else b""
    if FSTR and (got != old.encode() or re.match(rb"\w", before) or re.match(rb"\w", after)):
        n = FSTR[-1]; found = 0
        for l in range(n.lineno, n.end_lineno + 1):
            text = m.lines[l - 1]
            lo = n.col_offset if l == n.lineno else 0
            hi = n.end_col_offset if l == n.end_lineno else len(text)
            for mm in re.finditer(rb"(?<![\w])" + re.escape(old.encode()) + rb"(?!\w)", text[:hi]):
                if mm.start() < lo: continue
                pre = text[lo:mm.start()].replace(b"{{", b"").replace(b"}}", b"")
                if pre.rfind(b"{") > pre.rfind(b"}"):
                    m.edits[(l, mm.start())] = (old, new); found += 1
        if not found: problems.append(f"{m.file}:{line} in f-string {old!r}")
        return
    if got != old.encode():
        problems.append(f"{m.file}:{line}:{col} expected {old!r}, is {m.lines[line-1][col:col+20]!r}"); return
    m.edits[(line, col)] = (old, new)
def tkey(m): return m.file.replace(str(root), troot, 1)
class Walk:
    def __init__(self, m):
        self.m = m; self.scopes = []  # list of dict bindings, (kind)
        self.cls = []
        self.rec, self.calls = TYPES.get(tkey(m), ({}, {}))
    def resolve(self, name):
        for kind, sc in reversed(self.scopes):
            if kind == "class" and sc is not self.scopes[-1][1]: continue
            if name in sc: return sc[name]
        return self.m.bind.get(name)
    def newname(self, q):
        """new last name for a qual (not module)."""
        q = canon(q)
        if q in R: USED.add(q); return R[q]
        if q in PKGS or q in mods:
            n = newmod(q); return n.split(".")[-1]
        c, _, a = q.rpartition(".")
        if c in CLS: return lookup_used(c, a)
        if c and canon(c) in CLS: return lookup_used(canon(c), a)
        # parameters of methods: pkg.C.m.p, with overriding
        c2, _, meth = c.rpartition(".")
        if c2 in CLS:
            for k in mro(c2):
                if f"{k}.{meth}.{a}" in R: USED.add(f"{k}.{meth}.{a}"); return R[f"{k}.{meth}.{a}"]
        return None
    def static(self, e):
        """qual of an expression that names a module, class, function."""
        if isinstance(e, ast.Name):
            b = self.resolve(e.id)
            return canon(b.qual) if b else None
        if isinstance(e, ast.Attribute):
            b = self.static(e.value)
            if b and (b in PKGS or b in mods or b in CLS): return canon(b + "." + e.attr)
        return None
    def visit(self, n):
        f = getattr(self, "v_" + type(n).__name__, None)
        if f: f(n)
        else: self.children(n)
    def children(self, n):
        for c in ast.iter_child_nodes(n): self.visit(c)
    def v_JoinedStr(self, n):
        FSTR.append(n); self.children(n); FSTR.pop()
    def v_Name(self, n):
        b = self.resolve(n.id)
        if b and b.direct:
            new = self.newname(b.qual)
            if new: edit(self.m, n.lineno, n.col_offset, n.id, new)
    def attr_new(self, n):
        b = self.static(n.value)
        if b and (b in PKGS or b in mods):
            new = self.newname(b + "." + n.attr)
            return new, True
        if b and b in CLS:
            return lookup_used(b, n.attr) or (R.get(b + "." + n.attr)), True
        r = self.rec.get((n.lineno, n.col_offset, n.end_lineno, n.end_col_offset))
        if isinstance(n.value, ast.Name) and n.value.id in ("self", "cls") and self.cls:
            new = lookup_used(self.cls[-1], n.attr)
            if new: return new, True
            for s in SUBS[self.cls[-1]]:
                x = lookup_used(s, n.attr)
                if x: return x, True
        if isinstance(n.value, ast.Call) and isinstance(n.value.func, ast.Name) and n.value.func.id == "super" and self.cls:
            new = lookup_used(self.cls[-1], n.attr)
            return new, True
        if r is not None:
            name, full, own = r
            if full:
                q = canon(full)
                if q in R: USED.add(q); return R[q], True
            if own is not None:
                news = set()
                for cls, definers, mr in own:
                    x = None
                    for c in mr:
                        if c in CLS:
                            x = lookup_used(c, n.attr)
                            if x: break
                        if c + "." + n.attr in R: x = R[c + "." + n.attr]; break
                    if not x and not definers:
                        for c in mr:
                            for s in SUBS.get(c, ()):
                                x = x or lookup_used(s, n.attr)
                    news.add(x)
                news.discard(None) if len(news) > 1 else None
                if len(news) == 1:
                    x = next(iter(news))
                    if x: return x, True
                    if any(d for _, d, _ in own): return None, True
                elif len(news) > 1: problems.append(f"{self.m.file}:{n.lineno} union {n.attr}: {news}")
        return None, False
    def v_Attribute(self, n):
        self.visit(n.value)
        new, ok = self.attr_new(n)
        base = self.static(n.value) if not ok else None
        foreign = base is not None and base.split(".")[0] in ("pyarrow", "pa", "pq", "numpy", "np", "cv2", "yaml", "matplotlib", "plt", "rospy", "numba", "scipy", "pybullet", "trimesh", "tornado", "dask", "distributed", "PIL", "mujoco", "gymnasium", "sklearn", "pandas", "subprocess", "json", "ast", "socket", "threading")
        if not new and not ok and not foreign and n.attr in DEFS and any(DEFS[n.attr]):
            new = unique(n.attr)
            unresolved[n.attr].append((self.m.file, n.lineno, new))
        if new:
            # position: end - len
            edit(self.m, n.end_lineno, n.end_col_offset - len(n.attr.encode()), n.attr, new)
    def v_Call(self, n):
        self.visit(n.func)
        for a in n.args: self.visit(a)
        target = self.static(n.func)
        r = self.calls.get((n.lineno, n.col_offset, n.end_lineno, n.end_col_offset))
        for k in n.keywords:
            if k.arg:
                new = None; done = False
                cands = []
                fn = dotted(n.func) or ""
                if isinstance(n.func, ast.Name) and n.func.id == "cls" and self.cls: cands.append(("class", self.cls[-1]))
                if isinstance(n.func, ast.Attribute) and isinstance(n.func.value, ast.Call) and getattr(n.func.value.func, "id", "") == "super" and self.cls: cands.append(("super", self.cls[-1]))
                if target in CLS: cands.append(("class", target))
                elif target: cands.append(("func", target))
                if r and r[0]:
                    if r[0][0] == "class": cands.append(("class", r[0][1]))
                    elif r[0][1]: cands.append(("func", r[0][1]))
                if fn.split(".")[-1] in ("replace", "_replace", "with_", "evolve"):
                    for c in (r[1] if r else []): cands.append(("class", c))
                    if isinstance(n.func, ast.Attribute):
                        rr = self.rec.get((n.func.lineno, n.func.col_offset, n.func.end_lineno, n.func.end_col_offset))
                        for cls, _, mr in ((rr and rr[2]) or []): cands += [("class", c) for c in mr]
                if fn.split(".")[-1] == "partial" and n.args:
                    q0 = self.static(n.args[0])
                    if q0: cands.append(("class" if q0 in CLS else "func", q0))
                    if isinstance(n.args[0], ast.Attribute):
                        a0 = n.args[0]
                        rr = self.rec.get((a0.lineno, a0.col_offset, a0.end_lineno, a0.end_col_offset))
                        if isinstance(a0.value, ast.Name) and a0.value.id in ("self", "cls") and self.cls: cands.append(("func", self.cls[-1] + "." + a0.attr))
                        for cls, _, mr in ((rr and rr[2]) or []): cands += [("func", c + "." + a0.attr) for c in mr]
                for kind, q in cands:
                    if q is None: continue
                    q = canon(q)
                    if kind in ("class", "super"):
                        done = done or q in CLS
                        for c in mro(q):
                            new = R.get(c + "." + k.arg) or R.get(c + ".__init__." + k.arg) or R.get(c + ".__new__." + k.arg)
                            if new: USED.update(x for x in (c + "." + k.arg, c + ".__init__." + k.arg) if x in R); break
                    else:
                        new = R.get(q + "." + k.arg)
                        if new: USED.add(q + "." + k.arg)
                        c, _, meth = q.rpartition(".")
                        if not new and c in CLS:
                            for kk in mro(c):
                                new = new or R.get(f"{kk}.{meth}.{k.arg}")
                        done = done or q in FUNCS
                    if new: break
                if isinstance(n.func, ast.Attribute) and not new:
                    rr = self.rec.get((n.func.lineno, n.func.col_offset, n.func.end_lineno, n.func.end_col_offset))
                    for cls, _, mr in ((rr and rr[2]) or []):
                        for c in mr:
                            for kk in mro(c) or [c]:
                                new = new or R.get(f"{kk}.{n.func.attr}.{k.arg}")
                            done = True
                if not new and not done and k.arg in KEYDEFS and any(KEYDEFS[k.arg]):
                    s = KEYDEFS[k.arg]
                    new = next(iter(s)) if len(s) == 1 and fn.split(".")[-1] in ("SimpleNamespace", "Mock", "make", "build") else None
                    unresolved["KW " + k.arg].append((self.m.file, n.lineno, new))
                if new: edit(self.m, k.lineno, k.col_offset, k.arg, new)
            self.visit(k.value)
        # strings that name attributes
        fn = (dotted(n.func) or "").split(".")[-1]
        if fn in ("getattr", "hasattr", "setattr", "delattr", "attrgetter", "methodcaller"):
            for a in n.args[:2]:
                if isinstance(a, ast.Constant) and isinstance(a.value, str) and DEFS.get(a.value) and any(DEFS[a.value]):
                    new = None
                    if len(n.args) > 1:
                        b = self.static(n.args[0])
                        if b and (b in mods or b in PKGS): new = self.newname(b + "." + a.value)
                        elif b and b in CLS: new = lookup_used(b, a.value)
                        else: new = unique(a.value)
                    else: new = unique(a.value)
                    if new: self.string(a, a.value, new)
                    else: unresolved["STR " + a.value].append((self.m.file, n.lineno, None))
    def string(self, a, old, new):
        line = self.m.lines[a.lineno - 1]; col = line.find(old.encode(), a.col_offset)
        if col >= 0: edit(self.m, a.lineno, col, old, new)
    def v_Constant(self, n):
        if not isinstance(n.value, str): return
        v = n.value
        mm = re.fullmatch(r"(\.*)([A-Za-z_][\w.]*?)?(:[A-Za-z_]\w*)?", v)
        if not mm or "." not in v or n.end_lineno != n.lineno: return
        if v.startswith("."):
            lvl = len(mm.group(1)); q = absolute(self.m, lvl, mm.group(2) or "")
            if q not in mods and q not in PKGS: return
            new = relative(self.m, newmod(q), lvl)
        else:
            q = mm.group(2)
            if not q.startswith("aras_"): return
            cq = q
            parts = q.split(".")
            k = len(parts)
            while k and ".".join(parts[:k]) not in PKGS: k -= 1
            if not k: return
            mod = ".".join(parts[:k]); rest = parts[k:]
            new = newmod(mod); cur = mod
            for r_ in rest:
                x = self.newname(cur + "." + r_) or r_
                new += "." + x; cur = canon(cur + "." + r_)
        tail = mm.group(3) or ""
        if tail:
            x = self.newname(q + "." + tail[1:])
            if x: tail = ":" + x
        if new + tail != v: self.string(n, v, new + tail)
    def v_Dict(self, n):
        if self.m.is_pkg:
            for k, v in zip(n.keys, n.values):
                if isinstance(k, ast.Constant) and isinstance(v, ast.Constant) and isinstance(v.value, str) and v.value.startswith(".") and isinstance(k.value, str):
                    new = self.newname(self.m.name + v.value + "." + k.value)
                    if new: self.string(k, k.value, new)
        self.children(n)
    def v_arg(self, n):
        if n.annotation: self.visit(n.annotation)
        b = self.resolve(n.arg)
        if b:
            new = self.newname(b.qual)
            if new: edit(self.m, n.lineno, n.col_offset, n.arg, new)
    def name_token(self, n, word):
        """position of the name in a def/class statement."""
        line = self.m.lines[n.lineno - 1]
        mm = re.compile(rb"(def|class)\s+").search(line, n.col_offset)
        return n.lineno, mm.end()
    def func(self, n):
        q = self.prefix() + "." + n.name
        for d in n.decorator_list: self.visit(d)
        for d in [*n.args.defaults, *[x for x in n.args.kw_defaults if x]]: self.visit(d)
        if n.returns: self.visit(n.returns)
        new = self.newname(q)
        if new: l, c = self.name_token(n, n.name); edit(self.m, l, c, n.name, new)
        loc = {}
        for a in [*n.args.posonlyargs, *n.args.args, *n.args.kwonlyargs, *[x for x in (n.args.vararg, n.args.kwarg) if x]]:
            loc[a.arg] = B(q + "." + a.arg)
        g = {x for s in ast.walk(n) if isinstance(s, (ast.Global, ast.Nonlocal)) for x in s.names}
        col = {}; collect(self.m, n.body, q, col, True)
        for k, v in col.items():
            if k not in loc and k not in g: loc[k] = v
        # annotations of arguments belong to the outer scope, names to the inner
        for a in [*n.args.posonlyargs, *n.args.args, *n.args.kwonlyargs, *[x for x in (n.args.vararg, n.args.kwarg) if x]]:
            if a.annotation: self.visit(a.annotation)
            new = self.newname(q + "." + a.arg)
            if new: edit(self.m, a.lineno, a.col_offset, a.arg, new)
        self.scopes.append(("func", loc)); self.quals.append(q)
        for s in n.body: self.visit(s)
        self.scopes.pop(); self.quals.pop()
    quals = None
    def prefix(self): return self.quals[-1]
    v_FunctionDef = func; v_AsyncFunctionDef = func
    def v_Global(self, n):
        for name in n.names:
            b = self.resolve(name); new = b and self.newname(b.qual)
            if new:
                line = self.m.lines[n.lineno - 1]; mm = re.compile(rb"\b" + name.encode() + rb"\b").search(line, n.col_offset)
                edit(self.m, n.lineno, mm.start(), name, new)
    v_Nonlocal = v_Global
    def v_Lambda(self, n):
        for d in [*n.args.defaults, *[x for x in n.args.kw_defaults if x]]: self.visit(d)
        loc = {a.arg: B("<lambda>." + a.arg) for a in [*n.args.posonlyargs, *n.args.args, *n.args.kwonlyargs, *[x for x in (n.args.vararg, n.args.kwarg) if x]]}
        self.scopes.append(("func", loc)); self.visit(n.body); self.scopes.pop()
    def v_ClassDef(self, n):
        q = self.prefix() + "." + n.name
        for d in n.decorator_list + n.bases: self.visit(d)
        for k in n.keywords: self.visit(k.value)
        new = self.newname(q)
        if new: l, c = self.name_token(n, n.name); edit(self.m, l, c, n.name, new)
        col = {}; collect(self.m, n.body, q, col)
        self.scopes.append(("class", col)); self.quals.append(q); self.cls.append(q)
        for s in n.body:
            if isinstance(s, ast.Assign) and any(isinstance(t, ast.Name) and t.id in ("__slots__", "__match_args__", "_fields_order") for t in s.targets):
                for c in ast.walk(s.value):
                    if isinstance(c, ast.Constant) and isinstance(c.value, str):
                        x = lookup_used(q, c.value)
                        if x: self.string(c, c.value, x)
            self.visit(s)
        self.scopes.pop(); self.quals.pop(); self.cls.pop()
    def comp(self, n):
        loc = {}
        for g in n.generators:
            for x in target_names(g.target): loc[x] = B("<comp>." + x)
        self.scopes.append(("func", loc)); self.children(n); self.scopes.pop()
    v_ListComp = v_SetComp = v_DictComp = v_GeneratorExp = comp
    def v_Import(self, n):
        for a in n.names:
            nm = newmod(a.name)
            if a.name in PKGS and nm != a.name: edit(self.m, a.lineno, a.col_offset, a.name, nm)
    def v_ImportFrom(self, n):
        base = absolute(self.m, n.level, n.module)
        line = self.m.lines[n.lineno - 1]
        if base in PKGS or base in mods:
            nb = newmod(base)
            old = "." * n.level + (n.module or "")
            new = relative(self.m, nb, n.level) if n.level else nb
            # submodules that move elsewhere
            for a in n.names:
                q = base + "." + a.name
                if (q in mods or q in PKGS) and newmod(q).rpartition(".")[0] != nb:
                    target = newmod(q).rpartition(".")[0]
                    if len(n.names) == 1: new = relative(self.m, target, n.level) if n.level else target
                    else: problems.append(f"{self.m.file}:{n.lineno} from {old} import {a.name}: {newmod(q)}")
            if new != old:
                mm = re.compile(rb"from\s+").match(line, n.col_offset)
                edit(self.m, n.lineno, mm.end(), old, new)
        for a in n.names:
            if a.name == "*": continue
            new = self.newname(base + "." + a.name)
            if new and new != a.name:
                edit(self.m, a.lineno, a.col_offset, a.name, new)
                if a.asname == a.name:
                    l = self.m.lines[a.lineno - 1]; c = l.index(b" as ", a.col_offset) + 4
                    edit(self.m, a.lineno, c, a.name, new)
def relative(m, target, level):
    """relative module text from m's new place to target."""
    here = newmod(m.name).split(".")
    if not m.is_pkg: here = here[:-1]
    t = target.split(".")
    k = 0
    while k < len(here) and k < len(t) and here[k] == t[k]: k += 1
    return "." * (len(here) - k + 1) + ".".join(t[k:])
FUNCS = set(); KEYDEFS = defaultdict(set)
def find_funcs(body, prefix):
    for s in stmts(body):
        if isinstance(s, (ast.FunctionDef, ast.AsyncFunctionDef)):
            FUNCS.add(prefix + "." + s.name)
            for a in [*s.args.posonlyargs, *s.args.args, *s.args.kwonlyargs]:
                q = f"{prefix}.{s.name}.{a.arg}"; new = R.get(q)
                if not new and prefix in CLS:
                    for k in mro(prefix): new = new or R.get(f"{k}.{s.name}.{a.arg}")
                KEYDEFS[a.arg].add(new)
            find_funcs(s.body, prefix + "." + s.name)
        elif isinstance(s, ast.ClassDef):
            for x in s.body:
                if isinstance(x, ast.AnnAssign) and isinstance(x.target, ast.Name): KEYDEFS[x.target.id].add(lookup(prefix + "." + s.name, x.target.id))
            find_funcs(s.body, prefix + "." + s.name)
for m in mods.values(): find_funcs(m.tree.body, m.name)
for m in mods.values():
    w = Walk(m); w.quals = [m.name]
    for s in m.tree.body: w.visit(s)
    if m.is_pkg:
        for t, place in fromkeys(m):
            for e in t.elts:
                new = w.newname((m.name + place if place.startswith(".") else place) + "." + e.value)
                if new: w.string(e, e.value, new)
# ---------------------------------------------------------------- report
notfound = []
ALLQ = set(CLS) | FUNCS | {m.name + "." + n for m in mods.values() for n, b in m.bind.items() if b.qual == m.name + "." + n}
for q in R:
    if q in USED or q in ALLQ: continue
    notfound.append(q)
for o in MODS:
    if o not in PKGS: problems.append("no module " + o)
print("renames", len(R), "modules", len(MODS), "edits", sum(len(m.edits) for m in mods.values()), "files", sum(bool(m.edits) for m in mods.values()))
print("never used:", len(notfound)); [print("  NOTFOUND", q) for q in notfound[:400]]
print("problems", len(problems)); [print("  ", p) for p in problems[:200]]
amb = {k: v for k, v in unresolved.items() if any(x[2] is None for x in v)}
for k, v in sorted(unresolved.items()):
    for f, l, x in v:
        if x and "/tests/" not in f: print("  UNIQUE", k, x, f"{Path(f).relative_to(root)}:{l}")
print("unresolved left alone:", sum(len(v) for v in amb.values()), "renamed by unique name:", sum(1 for v in unresolved.values() for x in v if x[2]))
for k, v in sorted(amb.items()):
    key = k.split()[-1]; ds = DEFS.get(key) or KEYDEFS.get(key) or set()
    print("  LEFT", "HARD" if None not in ds else "soft", sorted(map(str, ds)), k, len(v), [f"{Path(f).relative_to(root)}:{l}" for f, l, x in v if not x][:6])
# collisions: new name already bound in the same scope, and not itself renamed away
for q, new in R.items():
    c, _, a = q.rpartition(".")
    if c in mods and new in mods[c].bind and (c + "." + new) not in R: print("  COLLIDES", q, new)
    if c in CLS:
        for k in {*mro(c), *SUBS[c]}:
            node = CLS[k][0]
            names = {s.name for s in node.body if isinstance(s, (ast.FunctionDef, ast.AsyncFunctionDef))} | {s.target.id for s in node.body if isinstance(s, ast.AnnAssign) and isinstance(s.target, ast.Name)}
            if new in names and lookup(k, new) is None: print("  COLLIDES", q, new, "in", k)
if not APPLY: sys.exit()
for m in mods.values():
    if not m.edits: continue
    lines = list(m.lines)
    for (l, c), (old, new) in sorted(m.edits.items(), reverse=True):
        lines[l - 1] = lines[l - 1][:c] + new.encode() + lines[l - 1][c + len(old.encode()):]
    open(m.file, "wb").write(b"\n".join(lines))
# ---------------------------------------------------------------- text
TEXT_SUFFIX = {".py", ".md", ".rst", ".launch", ".yaml", ".yml", ".sh", ".txt", ".xml", ".html", ".js", ".css", ".toml", ".cfg", ".in", ".msg", ".srv", ".action", ".test", ".ipynb", ".j2", ""}
hump = lambda n: len(re.findall(r"[A-Z]", n)) >= 2 and not n.isupper()
last = defaultdict(set)
for q, new in R.items():
    if KIND[q] != "param": last[q.split(".")[-1]].add(new)
def text_unique(name):
    s = last.get(name)
    if not s or len(s) != 1: return None
    if name in DEFS and None in DEFS[name]: return None
    return next(iter(s))
BIG = {q.split(".")[-1]: new for q, new in R.items() if KIND[q] == "class" and hump(q.split(".")[-1]) and text_unique(q.split(".")[-1])}
big_re = re.compile(r"(?<![\w/])(" + "|".join(sorted(map(re.escape, BIG), key=len, reverse=True)) + r")(?!\w)") if BIG else None
# module paths, dotted and with slashes, absolute or from the package's short name
PATHS = []
for m in mods.values():
    n = newmod(m.name)
    if n != m.name and m.name.startswith("aras_"): PATHS.append((m.name, n, m.is_pkg))
SHORT = {"aras_visual_servo_bench": "bench", "aras_visual_servo_controller": "controller", "aras_visual_servo_camera": "camera", "aras_visual_servo_base": "base", "aras_sim_bridge": "bridge"}
table = {}
for old, new, pkg in PATHS:
    p, *r = old.split("."); q, *t = new.split(".")
    if not r: continue
    table[".".join([p, *r])] = ".".join([q, *t])
    sl, sn = "/".join(r), "/".join(t)
    end = "/" if pkg else ".py"
    for pre in (p + "/", SHORT.get(p, p) + "/"):
        table[pre + sl + end] = pre + sn + end
        if pkg: table[pre + sl] = pre + sn
    if len(r) > 1 and not pkg: table[sl + end] = sn + end
    if pkg and len(r) > 1: table[sl + "/"] = sn + "/"
path_re = re.compile(r"(?<![\w./])((?:src/\w+/src/)?)(" + "|".join(sorted(map(re.escape, table), key=len, reverse=True)) + r")(?![\w])") if table else None
path_re2 = re.compile(r"(?<=[/\w])(" + "|".join(sorted((re.escape(k) for k in table if k.startswith("aras_") and "/" in k), key=len, reverse=True)) + r")(?![\w])")
tick_re = re.compile(r"(`{1,2})((?:\w+\.)*)(\w+)(\([^`]*\))?(`{1,2})")
left_text = defaultdict(int)
OWN = {}; LOCALS = set()
def set_file(f):
    OWN.clear(); LOCALS.clear()
    m = byfile.get(f)
    if not m: return
    for q, new in R.items():
        if q.startswith(m.name + ".") and KIND[q] != "param": OWN.setdefault(q.split(".")[-1], set()).add(new)
    for n in ast.walk(m.tree):
        if isinstance(n, ast.arg): LOCALS.add(n.arg)
        elif isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store): LOCALS.add(n.id)
PARAMS_OWN = defaultdict(set)
for q, new in R.items():
    if KIND[q] == "param": PARAMS_OWN[q.split(".")[-1]].add(q)
def text_new(word):
    if byfile_current[0] is not None:
        if word in LOCALS:
            mine = {R[q] for q in PARAMS_OWN.get(word, ()) if q.startswith(byfile_current[0] + ".")}
            kept = [1 for n in ast.walk(mods[byfile_current[0]].tree) if isinstance(n, ast.arg) and n.arg == word]
            if len(mine) == 1 and len(kept) == sum(1 for q in PARAMS_OWN[word] if q.startswith(byfile_current[0] + ".")) and word not in OWN: return next(iter(mine))
            return None
        if word in OWN: return next(iter(OWN[word])) if len(OWN[word]) == 1 else None
        return text_unique(word)
    return None if None in KEYDEFS.get(word, ()) else text_unique(word)
byfile_current = [None]
def tick(mm):
    pre, word, call = mm.group(2), mm.group(3), mm.group(4) or ""
    new = text_new(word)
    parts = [text_new(x) or x for x in pre.split(".")[:-1]] if pre else []
    if not new and word in last: left_text[word] += 1
    if call:
        pass
    return mm.group(1) + "".join(x + "." for x in parts) + (new or word) + call + mm.group(5)
def retext(t, code):
    if path_re:
        t = path_re.sub(lambda mm: mm.group(1) + table[mm.group(2)], t)
        t = path_re2.sub(lambda mm: table[mm.group(1)], t)
    if big_re: t = big_re.sub(lambda mm: BIG[mm.group(1)], t)
    if not code: t = tick_re.sub(tick, t)
    return t
for f in tracked:
    if "/upstream_" in f or Path(f).suffix not in TEXT_SUFFIX: continue
    byfile_current[0] = byfile[f].name if f in byfile else None; set_file(f)
    try: text = open(f, encoding="utf-8").read()
    except (UnicodeDecodeError, OSError): continue
    if f in byfile:
        # comments and strings only for ticks; paths and class names everywhere
        new = retext(text, True)
        out = []; lines = new.split("\n"); spans = []
        try:
            toks = list(tokenize.generate_tokens(io.StringIO(new).readline))
        except Exception as e: problems.append(f"{f} {e}"); toks = []
        starts = [0]
        for l in new.splitlines(keepends=True): starts.append(starts[-1] + len(l))
        res = []; pos = 0
        for t in toks:
            if t.type in (tokenize.COMMENT, tokenize.STRING):
                a = starts[t.start[0] - 1] + t.start[1]; b = starts[t.end[0] - 1] + t.end[1]
                res.append(new[pos:a]); res.append(tick_re.sub(tick, new[a:b])); pos = b
        res.append(new[pos:]); new = "".join(res)
    else: new = retext(text, False)
    if new != text: open(f, "w", encoding="utf-8").write(new)
print("text left:", dict(sorted(left_text.items(), key=lambda x: -x[1])[:60]))
# moves
for old, new in sorted(MODS.items(), key=lambda x: -x[0].count(".")):
    pass
moved = []
for m in sorted(mods.values(), key=lambda m: m.name):
    n = newmod(m.name)
    if n == m.name: continue
    r = next(r for r in ROOTS if m.file.startswith(r + "/"))
    new = Path(r) / (n.replace(".", "/") + ("/__init__.py" if m.is_pkg else ".py"))
    moved.append((m.file, str(new)))
folders = {}
for old, new in MODS.items():
    if old in mods and mods[old].is_pkg:
        r = next(r for r in ROOTS if mods[old].file.startswith(r + "/"))
        folders[str(Path(r) / old.replace(".", "/"))] = str(Path(r) / new.replace(".", "/"))
others = []
for f in tracked:
    if f in byfile: continue
    best = max((o for o in folders if f.startswith(o + "/")), key=len, default=None)
    if best: others.append((f, folders[best] + f[len(best):]))
for a, b in moved + others:
    Path(b).parent.mkdir(parents=True, exist_ok=True)
    subprocess.run(["git", "-C", str(root), "mv", a, b], check=True)
print("moved", len(moved), "+", len(others))
for a, b in others: print("   other", a, b)
subprocess.run(f"find {root}/src {root}/tests -type d -empty -not -path '*/.git/*' -delete", shell=True)
