import json,re,ast,sys,glob
from collections import defaultdict
root=sys.argv[1]
cls={}; bases=defaultdict(set)
for m in glob.glob("./map3_*.tsv"):
    pass
ren={}; rows=[]
for m in glob.glob("./map3_*.tsv"):
    for l in open(m):
        if l.startswith("#"): continue
        p=[x.strip() for x in l.split("#")[0].rstrip("\n").split("\t") if x.strip()]
        if len(p)==3: rows.append(p)
for k,o,n in rows:
    if k=="class": ren[o]=n
attr=defaultdict(dict)
for k,o,n in rows:
    if k in("attr","method"):
        c,a=o.rsplit(".",1); attr[ren.get(c,c.rsplit(".",1)[-1])][a]=n
for f in glob.glob(root+"/src/**/*.py",recursive=True)+glob.glob(root+"/tests/**/*.py",recursive=True):
    try: t=ast.parse(open(f).read())
    except Exception: continue
    for c in ast.walk(t):
        if isinstance(c,ast.ClassDef):
            for b in c.bases:
                n=b.id if isinstance(b,ast.Name) else b.attr if isinstance(b,ast.Attribute) else (b.value.id if isinstance(b,ast.Subscript) and isinstance(b.value,ast.Name) else None)
                if n: bases[c.name].add(n)
subs=defaultdict(set)
for c,bs in bases.items():
    for b in bs: subs[b].add(c)
def look(c,a,seen=None):
    seen=seen or set()
    if c in seen: return None
    seen.add(c)
    if a in attr.get(c,{}): return attr[c][a]
    for b in bases.get(c,()):
        r=look(b,a,seen)
        if r: return r
def down(c,a,seen=None):
    seen=seen or set(); out=set()
    for s in subs.get(c,()):
        if s in seen: continue
        seen.add(s)
        r=look(s,a)
        if r: out.add(r)
        out|=down(s,a,seen)
    return out
a=json.load(open('/tmp/pr0.json'))['generalDiagnostics']; b=json.load(open('/tmp/pr1.json'))['generalDiagnostics']
import collections
A=collections.Counter((x['rule'],re.sub(r"\d+","",x['message'])) for x in a)
edits=defaultdict(dict); left=[]
for x in b:
    k=(x['rule'],re.sub(r"\d+","",x['message']))
    if A[k]>0: A[k]-=1; continue
    m=re.match(r'Cannot (?:access|assign to|delete) attribute "(\w+)" for class "(?:type\[)?([\w.]+)',x['message'])
    f=x['file']; r=x['range']['start']
    if m:
        n=look(m[2],m[1])
        if not n:
            d=down(m[2],m[1]); n=next(iter(d)) if len(d)==1 else None
        if n: edits[f][(r['line'],r['character'])]=(m[1],n); continue
    left.append((f.replace(root+"/",""),r['line']+1,x['message'].split("\n")[0][:130]))
done=0
for f,es in edits.items():
    L=open(f).read().split("\n")
    for (l,c),(o,n) in sorted(es.items(),reverse=True):
        if L[l][c:c+len(o)]==o: L[l]=L[l][:c]+n+L[l][c+len(o):]; done+=1
        else: print("??",f,l,o,L[l][c:c+20])
    open(f,"w").write("\n".join(L))
print("fixed",done,"left",len(left))
for x in left: print(*x)
