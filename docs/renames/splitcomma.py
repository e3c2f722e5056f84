import sys, subprocess, json, tokenize, io
root=sys.argv[1]; ruff=root+"/.venv/bin/ruff"
def found():
    out=subprocess.run([ruff,"check","--no-cache","--select","E501","--output-format","json","."],cwd=root,capture_output=True,text=True).stdout
    d={}
    for e in json.loads(out): d.setdefault(e["filename"],set()).add(e["location"]["row"])
    return d
for it in range(3):
  for f,rows in found().items():
    text=open(f).read(); lines=text.split("\n"); depth=0; d0={}; cut={}
    for t in tokenize.generate_tokens(io.StringIO(text).readline):
        r=t.start[0]
        if r not in d0: d0[r]=depth
        if t.type==tokenize.OP:
            if t.string in "([{": depth+=1
            elif t.string in ")]}": depth-=1
            if t.string=="," and r in rows and depth>0 and t.end[1]<=100: cut.setdefault(r,[]).append((depth,t.end[1]))
        if t.type==tokenize.NAME and t.string in("for","if","else","and","or") and r in rows and depth>0 and 40<t.start[1]<=100: cut.setdefault(r,[]).append((depth,t.start[1]))
    for r in sorted(rows,reverse=True):
        if r not in cut: continue
        line=lines[r-1]; ind=len(line)-len(line.lstrip())
        if line[max(c for _,c in cut[r]):].strip().startswith("# fmt"): 
            pass
        low=min(d for d,c in cut[r] if c>45) if any(c>45 for d,c in cut[r]) else None
        if low is None: continue
        c=max(c for d,c in cut[r] if d==low and c>45)
        a,b=line[:c].rstrip(),line[c:].lstrip()
        if not b: continue
        extra=4 if low>d0[r] else 0
        lines[r-1:r]=[a," "*(ind+extra)+b]
    open(f,"w").write("\n".join(lines))
for f,rows in found().items():
    L=open(f).read().split("\n")
    for r in sorted(rows): print(f[len(root)+1:],r,L[r-1].strip()[:170])
