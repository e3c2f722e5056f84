import sys, subprocess, json, tokenize, io, re
root=sys.argv[1]; ruff=root+"/.venv/bin/ruff"
def found():
    out=subprocess.run([ruff,"check","--no-cache","--select","E501","--output-format","json","."],cwd=root,capture_output=True,text=True).stdout
    d={}
    for e in json.loads(out): d.setdefault(e["filename"],set()).add(e["location"]["row"])
    return d
for it in range(3):
  for f,rows in found().items():
    text=open(f).read(); lines=text.split("\n"); depth=0; todo=[]
    for t in tokenize.generate_tokens(io.StringIO(text).readline):
        if t.type==tokenize.OP:
            if t.string in "([{": depth+=1
            elif t.string in ")]}": depth-=1
        if t.type==tokenize.STRING and t.start[0]==t.end[0] and t.start[0] in rows and t.end[1]>=90 and not t.string.endswith('"""'): todo.append((t.start,t.end,t.string,depth))
    for (r,c),(_,e),s,dp in sorted(todo,reverse=True):
        line=lines[r-1]
        if len(line)<=100: continue
        m=re.match(r"([rbfRBF]*)(['\"])",s); pre,q=m.group(1),m.group(2)
        body=s[len(pre)+1:-1]
        best=None; b=0
        limit=98-c-len(pre)-1
        for i,ch in enumerate(body):
            if "f" in pre.lower():
                if ch=="{": b+=1
                if ch=="}": b-=1
            if ch==" " and b<=0 and i<limit: best=i+1
        if not best or best<8: 
            # whole string onto its own line?
            continue
        if dp==0: continue
        rest=body[best:]
        # f prefix only where braces
        p1=pre if ("{" in body[:best] or "f" not in pre) else pre.replace("f","")
        p2=pre if ("{" in rest or "f" not in pre) else pre.replace("f","")
        lines[r-1:r]=[line[:c]+p1+q+body[:best]+q," "*c+p2+q+rest+q+line[e:]]
    open(f,"w").write("\n".join(lines))
for f,rows in found().items():
    L=open(f).read().split("\n")
    for r in sorted(rows): print(f[len(root)+1:],r,L[r-1].strip()[:150])
