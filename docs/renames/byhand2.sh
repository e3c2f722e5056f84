P=$(git ls-files '*.py'; ls src/*/nodes/* src/*/scripts/* 2>/dev/null)
sed -i 's/linalg\.solve_inverse_kinematics/linalg.solve/g; s/trimesh\.resolvers\.DifferentialIK/trimesh.resolvers.Resolver/g; s/\._find_type\b/._type/g; s/pa\.make_schema(/pa.schema(/g; s/table\.make_schema\b/table.schema/g; s/scipy\.optimize\.solve_least_squares/scipy.optimize.least_squares/g; s/look\.find_symbol:/look.symbol:/; s/drawing\.count_elements()/drawing.elements()/; s/array\.make_markers\.append/array.markers.append/; s/options\.is_new\b/options.fresh/' $P
S=src/aras_visual_servo_base/src/aras_visual_servo_base/settings.py
sed -i "s/\"wanted\": expected/\"expected\": expected/; s/\"words\": splits_words/\"splits_words\": splits_words/; s/get('wanted')/get('expected')/g; s/get(\"wanted\")/get(\"expected\")/g; s/get(\"words\")/get(\"splits_words\")/g" $S
sed -i 's/wanted = {"wanted": /wanted = {"expected": /' src/aras_sim_bridge/src/aras_sim_bridge/camera/mounting.py
sed -i 's/^IMPORTS_JIT = .*/IMPORTS_JIT = re.compile(r"^from .*compiled import .*\\bjit", re.MULTILINE)/' src/aras_visual_servo_base/src/aras_visual_servo_base/compile_packages.py
sed -i 's/aras_visual_servo_base.loops/aras_visual_servo_base.compile_packages/' src/aras_visual_servo_base/cmake/*.cmake setup.sh
C=src/aras_visual_servo_controller/src/aras_visual_servo_controller
sed -i 's/\bseen_by\b/camera_name/g' $C/goals/goal.py $C/goals/goal_file.py; sed -i 's/`seen_by`/`camera_name`/' docs/scheme_interface.md
