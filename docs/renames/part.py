irr=set("told asked said seen kept held put set made done given taken built read sent found known met led left lost stood begun gone shown drawn written worn thrown hidden cut split spread bent hit let got become come run paid fed bound wound ground laid understood brought thought caught taught sought bought meant felt dealt kept slept swept wept spent lent rent torn borne sworn chosen frozen broken spoken woken stolen driven risen ridden shaken eaten fallen forgotten struck stuck swung sunk shrunk begun sung rung".split())
amb={"set","put","cut","split","read","run","let","hit","spread","ground","bound","left","become","come"}
noted={"need","feed","speed","seed","embed","bed","red"}
def participle(q,dec):
    name=q.split(".")[-1]
    if name.startswith("__"): return False
    if any("property" in x or "setter" in x for x in dec): return False
    b=name.strip("_")
    if re.match(r"(is|has|can)_",b): return False
    w=b.split("_"); first,last=w[0],w[-1]
    p=lambda x:(x.endswith("ed") and x not in noted) or x in irr-amb
    return p(first) or p(last)
