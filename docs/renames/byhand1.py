import re,glob,ast
def sub(f,a,b,n=None):
    t=open(f).read()
    if a not in t: print("MISSING",f,a[:60]); return
    open(f,"w").write(t.replace(a,b))
R="src/aras_sim_bridge/src/aras_sim_bridge/"; B="src/aras_visual_servo_bench/src/aras_visual_servo_bench/"; C="src/aras_visual_servo_controller/src/aras_visual_servo_controller/"; V="src/aras_visual_servo_camera/src/aras_visual_servo_camera/"; A="src/aras_visual_servo_base/src/aras_visual_servo_base/"
sub(R+"world/bullet_files.py",'look = f"<material name={quoteattr(link.name)}><color rgba={_format_numbers(colour)}/></material>"','''look = (
                f"<material name={quoteattr(link.name)}><color rgba={_format_numbers(colour)}/>"
                "</material>"
            )''')
sub(B+"cli/run.py",'''return f"{folder.count_stored_runs()} of {folder.study.run_count} runs are kept: {find_program_name()} resume {folder.path}"''','''return (
        f"{folder.count_stored_runs()} of {folder.study.run_count} runs are kept: "
        f"{find_program_name()} resume {folder.path}"
    )''')
sub(B+"ros/session_files.py",'''return f"the recorder has stopped: {LOG_PREFIX.sub('', self._recorder.read_last_lines(1).strip())}"''','''last_line = self._recorder.read_last_lines(1).strip()
        return f"the recorder has stopped: {LOG_PREFIX.sub('', last_line)}"''')
sub(V+"segmentation.py",'''return f"of {self.component_count} objects of target colour {COMPONENT_DESCRIPTIONS[self.component]}, {place}"''','''chosen = COMPONENT_DESCRIPTIONS[self.component]
        return f"of {self.component_count} objects of target colour {chosen}, {place}"''')
sub(C+"diagnosis/diagnoses/converged.py","remedy=CALIBRATE_CAMERA, open_distance","remedy=CALIBRATE_CAMERA,\n            open_distance")
sub(C+"features/luminance.py",'''return f"lens {goal_camera.model} {list(goal_camera.D)}; this one's is {camera.model} {list(camera.D)}"''','''return (
            f"lens {goal_camera.model} {list(goal_camera.D)}; "
            f"this one's is {camera.model} {list(camera.D)}"
        )''')
sub(C+"runner/loop_runner.py",'''reason = f"{reason}: {self._describe_stopped_clock() or self.servo.source.describe_silence()}"''','''why = self._describe_stopped_clock() or self.servo.source.describe_silence()
                reason = f"{reason}: {why}"''')
# __all__ lists
N={}
for m in ("bench","bridge","controller"):
    for l in open(f"./map_{m}.tsv"):
        l=l.split("#")[0].strip("\n"); p=[x.strip() for x in l.split("\t") if x.strip()]
        if len(p)==3 and p[0] in("class","func","const"): N.setdefault(p[1].split(".")[-1],set()).add((p[1],p[2]))
for f in glob.glob("src/*/src/**/*.py",recursive=True):
    t=open(f).read(); tree=ast.parse(t); b=set()
    for s in ast.walk(tree):
        if isinstance(s,(ast.ImportFrom,ast.Import)): b.update(a.asname or a.name for a in s.names)
        elif isinstance(s,(ast.FunctionDef,ast.ClassDef)): b.add(s.name)
        elif isinstance(s,ast.Name) and isinstance(s.ctx,ast.Store): b.add(s.id)
    for s in tree.body:
        if isinstance(s,ast.Assign) and getattr(s.targets[0],"id","")=="__all__" and isinstance(s.value,ast.List):
            src=ast.get_source_segment(t,s); new=src
            for e in s.value.elts:
                if isinstance(e,ast.Constant) and e.value not in b:
                    c=[n for q,n in N.get(e.value,()) if n in b]
                    if len(set(c))==1: new=new.replace(f'"{e.value}"',f'"{c[0]}"')
                    else: print(f,e.value,c)
            if new!=src: t=t.replace(src,new); open(f,"w").write(t)
