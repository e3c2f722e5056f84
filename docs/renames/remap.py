import ast,sys
from pathlib import Path
root=Path(sys.argv[1]); quals=set(); mods=set()
for p in root.glob("src/*/src/**/*.py"):
    rel=str(p).split("/src/")[-1]; mod=rel[:-3].replace("/",".").removesuffix(".__init__"); mods.add(mod)
    t=ast.parse(p.read_text())
    def walk(n,path,cls=None):
        for c in ast.iter_child_nodes(n):
            if isinstance(c,ast.ClassDef):
                q=path+"."+c.name; quals.add(q)
                for x in ast.walk(c):
                    if isinstance(x,ast.Attribute) and isinstance(x.ctx,ast.Store) and isinstance(x.value,ast.Name) and x.value.id in("self","cls"): quals.add(q+"."+x.attr)
                    if isinstance(x,ast.Call) and isinstance(x.func,ast.Attribute) and x.func.attr=="__setattr__" and len(x.args)>1 and isinstance(x.args[1],ast.Constant): quals.add(q+"."+str(x.args[1].value))
                walk(c,q)
            elif isinstance(c,(ast.FunctionDef,ast.AsyncFunctionDef)):
                q=path+"."+c.name; quals.add(q)
                for a in [*c.args.posonlyargs,*c.args.args,*c.args.kwonlyargs,*[y for y in (c.args.vararg,c.args.kwarg) if y]]: quals.add(q+"."+a.arg)
                walk(c,q)
            else:
                if isinstance(c,ast.Name) and isinstance(c.ctx,ast.Store): quals.add(path+"."+c.id)
                walk(c,path)
    walk(t,mod)
bysuf={}
oldmods=set(l.strip() for l in open("/tmp/oldmods.txt"))
for q in quals:
    parts=q.split("."); k=len(parts)
    while ".".join(parts[:k]) not in mods: k-=1
    bysuf.setdefault((parts[0],".".join(parts[k:])),set()).add(q)
miss=0
for m in ("bench","bridge","controller"):
    out=[]
    for line in open(f"map_{m}.tsv"):
        body=line.split("#")[0].rstrip("\n") if not line.startswith("#") else ""
        p=[x.strip() for x in body.split("\t") if x.strip()]
        if len(p)==3:
            k,old,new=p
            if k=="module":
                if old not in mods: print("module gone",old,new); continue
            elif old not in quals:
                parts=old.split("."); n=len(parts)
                while n and ".".join(parts[:n]) not in oldmods: n-=1
                suf=".".join(parts[n:]); c=bysuf.get((parts[0],suf),set())
                if len(c)==1: out.append("\t".join((k,c.copy().pop(),new))+"\n"); print("moved",old,"->",*c); continue
                miss+=1; print("MISS",k,old,new,len(c)); continue
        out.append(line)
    open(f"map3_{m}.tsv","w").writelines(out)
print(miss)
