"""longlines.py ROOT: wrap lines beyond 100 columns."""
import subprocess, sys, json, tokenize, io, textwrap, re, ast
from collections import defaultdict
root = sys.argv[1]; ruff = root + "/.venv/bin/ruff"
W = 100
def found():
    out = subprocess.run([ruff, "check", "--no-cache", "--select", "E501", "--output-format", "json", "."], cwd=root, capture_output=True, text=True).stdout
    d = defaultdict(set)
    for e in json.loads(out): d[e["filename"]].add(e["location"]["row"])
    return d
def kinds(text):
    """row -> kind"""
    k = {}
    tree = ast.parse(text); docs = set()
    for n in ast.walk(tree):
        if isinstance(n, (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)) and n.body and isinstance(n.body[0], ast.Expr) and isinstance(n.body[0].value, ast.Constant) and isinstance(n.body[0].value.value, str):
            s = n.body[0]; docs.add((s.lineno, s.end_lineno))
    for a, b in docs:
        for r in range(a, b + 1): k[r] = ("doc", a, b)
    for t in tokenize.generate_tokens(io.StringIO(text).readline):
        if t.type == tokenize.COMMENT:
            line = t.line
            k[t.start[0]] = ("comment",) if line.strip().startswith("#") else ("trailing", t.start[1])
        elif t.type == tokenize.STRING and t.end[0] > t.start[0]:
            for r in range(t.start[0], t.end[0] + 1): k.setdefault(r, ("string",))
    return k
def pass1(f, rows):
    text = open(f).read(); lines = text.split("\n"); k = kinds(text); code = []
    for r in sorted(rows, reverse=True):
        line = lines[r - 1]; kind = k.get(r, ("code",))
        ind = re.match(r"\s*", line).group()
        if kind[0] == "doc":
            body = line.strip(); tail = ""
            one = kind[1] == kind[2]
            if one and body.endswith('"""'): body = body[:-3]; tail = '"""'
            elif body.endswith('"""') : body = body[:-3]; tail = '"""'
            w = textwrap.wrap(body, W - len(ind), break_long_words=False, break_on_hyphens=False)
            hang = "    " if re.match(r"\w+: ", body) and not body.startswith('"""') and r > kind[1] + 1 else ""
            # merge the rest with the following line of the paragraph where it has one
            out = [ind + w[0]]; rest = " ".join(w[1:])
            nxt = lines[r] if r < len(lines) and r < kind[2] else ""
            ni = re.match(r"\s*", nxt).group()
            if rest and nxt.strip() and not nxt.strip().startswith('"""') and not tail and not re.match(r"[-*] |\w+: |>>>|\w+:$", nxt.strip()):
                body2 = rest + " " + nxt.strip(); t2 = ""
                if body2.endswith('"""'): body2 = body2[:-3]; t2 = '"""'
                w2 = textwrap.wrap(body2, W - len(ni) - 3, break_long_words=False, break_on_hyphens=False)
                out += [ni + x for x in w2]
                if t2: out[-1] += t2
                lines[r - 1:r + 1] = out
                continue
            if rest: out += [ind + hang + x for x in textwrap.wrap(rest, W - len(ind) - 7)]
            if tail:
                if one: out += [ind + tail]
                else: out[-1] += tail
            lines[r - 1:r] = out
        elif kind[0] == "comment":
            body = line.strip()[1:].strip()
            if re.match(r"-- .* -+$", body):
                lines[r - 1] = line.rstrip("-")[:W].rstrip() + " " if False else re.sub(r"-+$", "", line) + "-" * max(0, W - 5 - len(re.sub(r"-+$", "", line)))
                continue
            w = textwrap.wrap(body, W - len(ind) - 2, break_long_words=False, break_on_hyphens=False)
            out = [ind + "# " + w[0]]; rest = " ".join(w[1:])
            nxt = lines[r] if r < len(lines) else ""
            if rest and nxt.strip().startswith("# ") and not nxt.strip().startswith("# --") and nxt.startswith(ind + "#"):
                w2 = textwrap.wrap(rest + " " + nxt.strip()[2:], W - len(ind) - 2, break_long_words=False, break_on_hyphens=False)
                out += [ind + "# " + x for x in w2]; lines[r - 1:r + 1] = out
            else:
                if rest: out.append(ind + "# " + rest)
                lines[r - 1:r] = out
        elif kind[0] == "trailing":
            c = line[kind[1]:]
            if "noqa" in c or "fmt:" in c or "type:" in c: code.append(r); continue
            prev = lines[r - 2].rstrip() if r > 1 else ""
            lines[r - 1:r] = [ind + c, line[:kind[1]].rstrip()]
        else: code.append(r)
    open(f, "w").write("\n".join(lines))
for i in range(4):
    for f, rows in found().items(): pass1(f, rows)
for f, rows in found().items():
    for r in sorted(rows, reverse=True):
        subprocess.run([ruff, "format", "-q", "--range", f"{r}-{r + 1}", f], cwd=root)
left = found()
print(sum(map(len, left.values())), "left")
for f, rows in left.items():
    for r in sorted(rows): print(f"{f}:{r}: {open(f).read().splitlines()[r-1].strip()[:140]}")
