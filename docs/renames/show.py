import ast,sys,re
from pathlib import Path
sys.path.insert(0,"/work/tools")
exec(open("./part.py").read())
WORDS="told tell tells asked ask wanted mend mends mended anew beside nobody somebody whoever whatever lets stands stand begins begin begun reckon heed said words eye eyes wish wishes way ways seen kept keep keeping heard hear hears felt feel held hold picture pictures look looks looked known taken takes brought left found given lane drain answers apart shown drawn made done met written placed posed lost chosen believed belief story outlook bears let goes go gone come comes became whence beyond headed way once still since meant mean_ others other_ "
words=set(WORDS.split())
root=Path("/work/main")
mode=None; args=sys.argv[1:]
if args and args[0].startswith("--"): mode=args.pop(0)
pre=args[0]
for p in sorted(root.glob("src/*/src/**/*.py")):
    rel=str(p.relative_to(root)).split("/src/",1)[1].split("/",0)[0]
    rel=str(p).split("/src/")[-1]
    if not rel.startswith(pre): continue
    t=ast.parse(p.read_text()); mod=rel[:-3].replace("/",".").removesuffix(".__init__")
    d=lambda n:(ast.get_docstring(n) or "").split("\n")[0][:110]
    if not mode: print(f"\n== {mod} | {d(t)}")
    idents=set()
    def walk(n,path,ind):
        for c in ast.iter_child_nodes(n):
            if isinstance(c,ast.ClassDef):
                q=path+"."+c.name
                if not mode:
                    print(" "*ind+f"class {c.name}({', '.join(map(ast.unparse,c.bases))}) | {d(c)}")
                    fs=[x.target.id for x in c.body if isinstance(x,ast.AnnAssign) and isinstance(x.target,ast.Name)]+[t2.id for x in c.body if isinstance(x,ast.Assign) for t2 in x.targets if isinstance(t2,ast.Name)]
                    ats={x.attr for x in ast.walk(c) if isinstance(x,ast.Attribute) and isinstance(x.ctx,ast.Store) and isinstance(x.value,ast.Name) and x.value.id=="self"}
                    if fs: print(" "*ind+"    fields: "+" ".join(fs))
                    if ats-set(fs): print(" "*ind+"    self: "+" ".join(sorted(ats-set(fs))))
                for x in c.body:
                    if isinstance(x,ast.AnnAssign) and isinstance(x.target,ast.Name): idents.add(("attr",q+"."+x.target.id))
                for x in ast.walk(c):
                    if isinstance(x,ast.Attribute) and isinstance(x.ctx,ast.Store) and isinstance(x.value,ast.Name) and x.value.id=="self": idents.add(("attr",q+"."+x.attr))
                idents.add(("class",q)); walk(c,q,ind+4)
            elif isinstance(c,(ast.FunctionDef,ast.AsyncFunctionDef)):
                q=path+"."+c.name; dec=[ast.unparse(x) for x in c.decorator_list]
                a=[x.arg for x in c.args.posonlyargs+c.args.args+c.args.kwonlyargs if x.arg not in("self","cls")]
                idents.add(("func",q)); idents.update(("param",q+"."+x) for x in a)
                if not mode: print(" "*ind+("@"+",".join(x.split("(")[0] for x in dec)+" " if dec else "")+f"{c.name}({', '.join(a)}) | {d(c)}")
                if mode=="--participles" and participle(q,dec): print(q,"|",d(c))
                walk(c,q,ind+4)
            else:
                if n is t and isinstance(c,(ast.Assign,ast.AnnAssign)):
                    ts=c.targets if isinstance(c,ast.Assign) else [c.target]
                    for x in ts:
                        if isinstance(x,ast.Name):
                            idents.add(("const",path+"."+x.id))
                            if not mode: print(" "*ind+f"{x.id} = {ast.unparse(c.value)[:60] if c.value else ''}")
                walk(c,path,ind)
    walk(t,mod,2)
    if mode=="--words":
        for k,q in sorted(idents):
            last=q.split(".")[-1]
            ws=re.sub(r"(?<=[a-z])(?=[A-Z])","_",last).lower().strip("_").split("_")
            if set(ws)&words: print(k,q)
