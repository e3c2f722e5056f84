"""typer.py ROOT OUT.pickle: for each project file, the classes of the bases of attributes and of callees."""
import sys, glob, pickle, time
from pathlib import Path
from mypy import build, options as mo, nodes as N, types as T
from mypy.modulefinder import BuildSource
from mypy.find_sources import create_source_list
from mypy.fscache import FileSystemCache
root = Path(sys.argv[1]).resolve()
o = mo.Options()
o.python_version = (3, 11); o.incremental = False; o.preserve_asts = True; o.export_types = True
o.check_untyped_defs = True; o.ignore_missing_imports = True; o.namespace_packages = True; o.explicit_package_bases = True
o.follow_untyped_imports = False; o.cache_dir = "/dev/null"; o.python_executable = "./.venv/bin/python"
o.allow_redefinition = False; o.implicit_reexport = True; o.sqlite_cache=False
roots = sorted(glob.glob(str(root / "src/*/src")))
o.mypy_path = roots + [str(root / "tests"), str(root / "tests/benchmarks"), "./devel/lib/python3/dist-packages"]
# unmatched third parties: do not follow
for m in ("cv2","numba","scipy","pandas","matplotlib","rospy","trimesh","pybullet","pyarrow","dask","distributed","gymnasium","sklearn","torch","mujoco","tornado","PIL","hypothesis","pytest"):
    pass
o.per_module_options = {m + '.*': {'follow_imports': 'skip'} for m in ('scipy','numba','matplotlib','pandas','sklearn','dask','distributed','torch','pyarrow','trimesh','hypothesis','mujoco','tornado','sphinx','docutils','llvmlite','PIL','jinja2','statsmodels')}
o.build_per_module_cache() if False else None
o.process_error_codes(error_callback=print)
files = []
for r in roots: files += glob.glob(r + "/**/*.py", recursive=True)
files += [f for f in glob.glob(str(root / "tests/**/*.py"), recursive=True)]
files += glob.glob(str(root / "docs/**/*.py"), recursive=True)
def modname(f):
    for r in roots + [str(root / "tests/benchmarks"), str(root / "tests"), str(root)]:
        if f.startswith(r + "/"): return f[len(r)+1:-3].replace("/", ".").removesuffix(".__init__")
srcs = [BuildSource(f, modname(f), None, None, False) if False else BuildSource(f, modname(f)) for f in files]
t = time.time()
res = build.build(srcs, o, None, None, FileSystemCache())
print("built", time.time() - t, len(res.errors))
types = res.types
def infos(ty, depth=0):
    """TypeInfos / modules that a type may be."""
    ty = T.get_proper_type(ty) if ty is not None else None
    if ty is None: return None
    if isinstance(ty, T.AnyType): return None
    if isinstance(ty, T.Instance): return [ty.type]
    if isinstance(ty, T.TupleType): return [ty.partial_fallback.type]
    if isinstance(ty, T.TypedDictType): return [ty.fallback.type]
    if isinstance(ty, T.LiteralType): return [ty.fallback.type]
    if isinstance(ty, T.NoneType): return []
    if isinstance(ty, T.UnionType):
        out = []
        for i in ty.items:
            x = infos(i, depth + 1)
            if x is None: continue
            out += x
        return out or None
    if isinstance(ty, T.TypeVarType): return infos(ty.upper_bound)
    if isinstance(ty, T.TypeType): return infos(ty.item)
    if isinstance(ty, T.FunctionLike):
        if ty.is_type_obj(): return [ty.type_object()]
        return [ty.fallback.type]
    return None
def owner(info, name):
    """first definer in MRO reversed: root-most class with name."""
    found = [c.fullname for c in info.mro if name in c.names]
    return found
SKIP = {"node","info","type","unanalyzed_type","def_frame","analyzed","method_type","defn","partial_types","names","imports","mro","metaclass_type","original_def","type_guard","deprecated","setter_index","setter_type","alias","type_args","unanalyzed_items","method_types","inferred_types","right_always","special_sig","is_alias_def","_fullname","fallback","removed_base_type_exprs","plugin_deps","future_import_flags"}
def attrs(cls, cache={}):
    if cls not in cache:
        cache[cls] = [a for c in cls.__mro__ for a in getattr(c, "__mypyc_attrs__", ()) if a not in SKIP and a != "__dict__"]
    return cache[cls]
class Rec:
    def __init__(self): self.rec = {}; self.calls = {}
    def member(self, e):
        base = types.get(e.expr)
        full = e.fullname if e.kind == N.GDEF and e.fullname else None
        x = infos(base) if base is not None else None
        own = None
        if x is not None:
            own = [(i.fullname, owner(i, e.name), [c.fullname for c in i.mro]) for i in x]
        self.rec[(e.line, e.column, e.end_line, e.end_column)] = (e.name, full, own)
    def call(self, e):
        if any(k is not None for k in e.arg_names):
            ty = types.get(e.callee); ty = T.get_proper_type(ty) if ty is not None else None
            d = None
            if isinstance(ty, T.CallableType):
                if ty.is_type_obj(): d = ("class", ty.type_object().fullname, [c.fullname for c in ty.type_object().mro])
                elif ty.definition is not None: d = ("func", getattr(ty.definition, "fullname", None), None)
            arg0 = infos(types.get(e.args[0])) if e.args and types.get(e.args[0]) is not None else None
            self.calls[(e.line, e.column, e.end_line, e.end_column)] = (d, [c.fullname for i in (arg0 or []) for c in i.mro])
    def walk(self, root):
        seen = set(); stack = [root]
        while stack:
            n = stack.pop()
            if isinstance(n, (list, tuple)): stack.extend(n); continue
            if isinstance(n, dict): stack.extend(n.keys()); stack.extend(n.values()); continue
            if not isinstance(n, N.Node) or isinstance(n, (N.TypeInfo, N.Var)) or id(n) in seen: continue
            seen.add(id(n))
            if isinstance(n, N.MypyFile) and n is not root: continue
            if isinstance(n, N.MemberExpr): self.member(n)
            elif isinstance(n, N.CallExpr): self.call(n)
            for a in attrs(type(n)):
                try: v = getattr(n, a)
                except Exception: continue
                if isinstance(v, (N.Node, list, tuple, dict)): stack.append(v)
V = Rec
out = {}; mros = {}
for name, f in res.files.items():
    if not f.path or not f.path.startswith(str(root)): continue
    v = V()
    try: v.walk(f)
    except Exception as err: print("ERR", f.path, err)
    out[f.path] = (v.rec, v.calls)
pickle.dump(out, open(sys.argv[2], "wb"))
n = sum(len(r) for r, _ in out.values()); u = sum(1 for r, _ in out.values() for x in r.values() if x[1] is None and x[2] is None)
print(len(out), "files", n, "attributes", u, "unresolved")
