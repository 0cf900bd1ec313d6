package leaprig;

import java.util.concurrent.ArrayBlockingQueue;
import java.util.concurrent.atomic.AtomicReference;

/**
 * One client after another. The reader of its lines calls `receive` and gets the answer; one thread of its own calls
 * `cycle` each millisecond, answers what only the main thread of the toolbox answers, and is alone in moving the arm.
 * Time is handed in, in seconds.
 */
final class Session {
    enum Mode { IDLE, MOTION, PAUSED, SERVO, HELD }

    enum Demand { NONE, CANCEL, RESUME, PAUSE, STOP }

    /** Where lines to the client go; never waits. */
    interface Out {
        void send(String text);

        void close();
    }

    interface Log {
        void info(String sentence);
    }

    static final String VERSION = "1";
    static final String ABILITIES = "watchdog_stop_contact_tool_soft_float_guide_state";
    static final double OLD_CLIENT_SILENT = 60;
    /** The last word of a motion comes no sooner after the first, refused or not [s]: old clients read them apart. */
    static final double LAST_WORD = 0.016;
    static final double REFUSAL = 0.052;
    private static final double CANCEL_AGAIN = 0.1;
    private static final double SAFETY_EVERY = 0.01;

    private final Arm arm;
    private final Log log;
    private final Watchdog watchdog;
    private final Goals goals = new Goals();
    private final Servo servo;
    private final ToolData tool = new ToolData();
    private final ArrayBlockingQueue<Request> words = new ArrayBlockingQueue<Request>(8);
    private final AtomicReference<Demand> demand = new AtomicReference<Demand>(Demand.NONE);
    private volatile Mode mode = Mode.IDLE;
    private volatile Out out;
    private volatile Out channel;
    private volatile String holder;
    private volatile int number;
    private volatile boolean hello;
    private volatile boolean leaving;
    private volatile boolean servoEnds;
    private volatile double beat;
    private volatile int stops;
    private volatile double[] contact;
    private volatile double longestCycle;
    private volatile String held = "";
    private volatile boolean keeps;
    private volatile Request kept;
    private final double[] stored = new double[6];
    private final double[] via = new double[6];
    private final double[] end = new double[6];

    private double speed = 0.1;
    private Soft soft = Soft.STIFF;
    private Motion motion;
    private String ending;
    private boolean refused;
    private double lastWordDue;
    private double cancelled;
    private double lastCycle = Double.NaN;
    private double longest;
    private int cycles;
    private double safetyAsked = Double.NEGATIVE_INFINITY;
    private String safety = "NOSTOP";

    Session(Arm arm, Log log, Watchdog watchdog) {
        this.arm = arm;
        this.log = log;
        this.watchdog = watchdog;
        servo = new Servo(arm);
    }

    Mode mode() { return mode; }

    /** Admits a client; returns null, or who holds the arm. A holder that is silent for too long is sent away. */
    synchronized String admit(String who, Out to, int sessionNumber, double now) {
        if (holder != null) {
            double patience = hello ? watchdog.end() : OLD_CLIENT_SILENT;
            if (!leaving && now - beat > patience && mode != Mode.MOTION) {
                log.info(holder + " has been silent for " + Math.round(now - beat) + " s and is sent away for " + who);
                leave(out);
            }
            return holder;
        }
        out = to;
        number = sessionNumber;
        hello = false;
        beat = now;
        holder = who;
        log.info(who + " holds the arm");
        return null;
    }

    /** Whether the holder is about to go, so that the next one may ask again soon. */
    boolean changing() { return leaving; }

    /** The client of these lines is gone, or is to go: what moves stops, and the next one may come. */
    synchronized void leave(Out of) {
        if (of == null || of != out) return;
        leaving = true;
        of.close();
    }

    /** Joins a second connection to the session of a number; returns its answer. */
    synchronized String join(Request request, Out to) {
        if (holder == null || !hello || request.refusal() != null || request.numbers[0] != number)
            return Text.no(Word.CHANNEL, "no such session");
        if (channel != null) channel.close();
        channel = to;
        return Text.ok(Word.CHANNEL, number);
    }

    synchronized void leaveChannel(Out of) {
        if (channel == of) channel = null;
    }

    /** Stops whatever moves; from anybody, at any time. */
    void stop() {
        stops++;
        demand.set(Demand.STOP);
    }

    /** Answers a word of the second connection. */
    String second(Request request) {
        if (request.word == Word.STOP) {
            stop();
            return Text.ok(Word.STOP);
        }
        if (request.word == Word.PAUSE || request.word == Word.RESUME || request.word == Word.CANCEL)
            return demanded(request.word);
        if (request.word == Word.STATE) return state();
        return Text.no(request.word, "not on this connection");
    }

    private String demanded(Word word) {
        Demand wanted = Demand.valueOf(word.name());
        boolean fits = wanted == Demand.PAUSE ? mode == Mode.MOTION || mode == Mode.SERVO
                : wanted == Demand.RESUME ? mode == Mode.PAUSED || mode == Mode.HELD : mode == Mode.PAUSED;
        if (!fits) return Text.no(word, "the mode is " + mode);
        return demand.compareAndSet(Demand.NONE, wanted) ? Text.ok(word) : Text.no(word, "another demand is open");
    }

    /** Answers a line of the client on that connection; null: no answer now, or none at all. */
    String receive(Request request, Out from, double now) {
        if (from != out || leaving) return null;
        beat = now;
        Word word = request.word;
        if (word == Word.HELLO) {
            if (request.refusal() != null) return null;
            hello = true;
            return "ok_" + word.text + "_leapRig_" + VERSION + '_' + number + '_' + ABILITIES + "_\n";
        }
        if (keeps) kept = word != null && word.main() ? request.copy(stops, from) : null;
        if (word == null) return hello ? Text.no(null, "unknown") : null;
        if (word == Word.STOP) {
            stop();
            return Text.ok(Word.STOP);
        }
        if (word.ours() && !hello) return null;
        String no = hello ? refusal(request) : request.fault;
        if (word.main()) {
            if (hello && no != null) return Text.no(word, no);
            if (word.kind == Word.Kind.OURS_AT_REST && mode != Mode.IDLE) return Text.no(word, "the arm is not at rest");
            if (mode == Mode.IDLE) words.offer(request.copy(stops, from));
            return null;
        }
        if (no != null) return hello ? Text.no(word, no) : null;
        return answer(request, now);
    }

    private String refusal(Request request) {
        if (request.word.old()) return "not offered to a client that says hello";
        String no = request.refusal();
        Word.Kind kind = request.word.kind;
        if (no == null && (kind == Word.Kind.JOINT_GOAL || request.word == Word.GOAL_STATE)) {
            int joint = Limits.outside(request.numbers);
            if (joint >= 0) no = "joint " + (joint + 1) + " is " + request.numbers[joint] + " rad, beyond its range";
        }
        if (no == null && (kind == Word.Kind.JOINT_GOAL || request.word == Word.GOAL_STATE) && mode == Mode.HELD) no = "held: " + held;
        return no;
    }

    private String answer(Request request, double now) {
        switch (request.word) {
            case END:
                leave(out);
                return null;
            case STOP_SERVO:
                servoEnds = mode == Mode.SERVO || mode == Mode.HELD;
                return Text.DONE;
            case GET_JOINTS:
                return feedback(request.word);
            case BEAT:
                return Text.ok(Word.BEAT);
            case STATE:
                return state();
            case GOAL_STATE:
                String before = state();
                goals.setJoints(request.numbers, request.count);
                return before;
            case PAUSE:
            case RESUME:
            case CANCEL:
                return demanded(request.word);
            case WATCHDOG:
                String no = watchdog.set(request.numbers[0], request.numbers[1]);
                return no != null ? Text.no(request.word, no)
                        : Text.ok(request.word, watchdog.brake(), watchdog.end());
            case CONTACT:
                return contact(request);
            case CHANNEL:
                return Text.no(request.word, "not on this connection");
            default:
                return goalOrPin(request, now);
        }
    }

    private String goalOrPin(Request request, double now) {
        Word word = request.word;
        if (word.kind == Word.Kind.PIN) return "1\n\n";
        if (word.kind == Word.Kind.OUTPUT) return Text.DONE;
        if (request.count > word.most && word.kind != Word.Kind.JOINT_GOAL) return null;
        if (word.kind == Word.Kind.POSE_STORED) {
            double[] into = word == Word.POSE_TARGET ? stored : word == Word.CIRCLE_VIA ? via : end;
            synchronized (into) {
                System.arraycopy(request.numbers, 0, into, 0, request.count);
            }
            return Text.DONE;
        }
        String reply = feedback(word);
        if (word.kind == Word.Kind.JOINT_GOAL) goals.setJoints(request.numbers, request.count);
        else if (word.kind == Word.Kind.POSE_GOAL) goals.setPose(request.numbers, request.count);
        else goals.setSpeed(request.numbers, request.count, now);
        return reply;
    }

    private String feedback(Word word) {
        switch (word) {
            case GET_JOINTS:
            case JOINTS_JOINTS:
            case POSE_JOINTS:
            case SPEED_JOINTS:
                double[] joints = new double[7];
                arm.joints(joints);
                return Text.line(joints);
            case JOINTS_EXTERNAL:
            case POSE_EXTERNAL:
            case SPEED_EXTERNAL:
                return Text.line(arm.externalTorques());
            case JOINTS_MEASURED:
            case POSE_MEASURED:
            case SPEED_MEASURED:
                return Text.line(arm.measuredTorques());
            case JOINTS_POSE:
            case POSE_POSE:
            case SPEED_POSE:
                return Text.line(arm.pose());
            case JOINTS_FORCE:
            case POSE_FORCE:
                return Text.line(arm.force());
            case JOINTS_SILENT:
            case POSE_SILENT:
                return null;
            default:
                return Text.DONE;
        }
    }

    private String contact(Request request) {
        double[] n = java.util.Arrays.copyOf(request.numbers, 8);
        String no = Limits.refuse("a torque", n, 0, 7, 0, 320);
        if (no == null) no = Limits.refuse("the force", n, 7, 8, 0, 500);
        if (no != null) return Text.no(request.word, no);
        contact = n;
        return Text.ok(request.word, n);
    }

    /** Mode, joints, measured torques, external torques, force, moment, longest cycle [ms], operation mode, enabling, safety. */
    private String state() {
        double[] joints = new double[7];
        arm.joints(joints);
        StringBuilder text = new StringBuilder("state_").append(mode).append('_');
        Text.add(text, joints);
        Text.add(text, arm.measuredTorques());
        Text.add(text, arm.externalTorques());
        Text.add(text, arm.force());
        Text.add(text, arm.moment());
        text.append(1000 * longestCycle).append('_').append(Text.plain(arm.operationMode())).append('_');
        text.append(Text.plain(arm.enabling())).append('_').append(Text.plain(arm.safetyStop())).append("_\n");
        return text.toString();
    }

    /** One cycle of the main thread. */
    void cycle(double now) {
        if (now > lastCycle) longest = Math.max(longest, now - lastCycle);
        lastCycle = now;
        if (++cycles % 100 == 0) {
            longestCycle = longest;
            longest = 0;
        }
        Demand wanted = demand.getAndSet(Demand.NONE);
        try {
            if (mode == Mode.IDLE) idle(now);
            else if (mode == Mode.MOTION) moving(wanted, halt(wanted, now), now);
            else if (mode == Mode.PAUSED) paused(wanted, halt(wanted, now), now);
            else serving(wanted, halt(wanted, now), now);
        } catch (RuntimeException error) {
            fail(error);
        }
    }

    /** What the controller throws ends what runs; the session goes on. */
    private void fail(RuntimeException error) {
        log.info("the controller gives up: " + error);
        Mode before = mode;
        Motion was = motion;
        settle();
        if (before == Mode.SERVO || before == Mode.HELD) {
            quietly(before);
            ended("the controller gave up");
        } else {
            if (was != null) quietly(before);
            say(Text.NAK);
            forgetTool();
        }
    }

    private void quietly(Mode before) {
        try {
            if (before == Mode.SERVO || before == Mode.HELD) servo.stop();
            else arm.cancel();
        } catch (RuntimeException error) {
            log.info("and does not stop in order: " + error);
        }
    }

    private void settle() {
        motion = null;
        ending = null;
        refused = false;
        servoEnds = false;
        keeps = false;
        held = "";
        mode = Mode.IDLE;
    }

    /** The server attaches the flange itself after a refusal, as the toolbox does; who said hello keeps its tool. */
    private void forgetTool() {
        if (hello) return;
        tool.forget();
        try {
            arm.attach(tool);
        } catch (RuntimeException error) {
            log.info("no tool could be attached: " + error);
        }
    }

    private void say(String text) {
        Out to = out;
        if (to != null && text != null && !leaving) to.send(text);
    }

    private void tell(String what) {
        log.info(what);
        Out to = channel;
        if (to != null) to.send(Text.event(what));
    }

    /** Returns why what moves must stop now, or null. */
    private String halt(Demand wanted, double now) {
        if (leaving) return "the client is gone";
        if (wanted == Demand.STOP) return "the client";
        if (!hello) return null;
        if (mode != Mode.SERVO && mode != Mode.HELD && watchdog.judge(now - beat) != Watchdog.Verdict.ALIVE)
            return "the watchdog";
        if (now - safetyAsked >= SAFETY_EVERY) {
            safetyAsked = now;
            safety = arm.safetyStop();
        }
        return safety.equals("NOSTOP") ? null : "a safety stop, " + safety;
    }

    private void idle(double now) {
        if (leaving) {
            farewell();
            return;
        }
        Request request = words.poll();
        if (request == null || request.from != out) return;
        if (request.fault != null) {
            say(Text.NAK);
            forgetTool();
            return;
        }
        execute(request, now);
    }

    private synchronized void farewell() {
        log.info(holder + " has gone");
        words.clear();
        if (channel != null) channel.close();
        channel = null;
        contact = null;
        soft = Soft.STIFF;
        hello = false;
        forgetTool();
        watchdog.reset();
        holder = null;
        out = null;
        leaving = false;
    }

    private void execute(Request request, double now) {
        double[] n = java.util.Arrays.copyOf(request.numbers, request.count);
        switch (request.word) {
            case ATTACH:
                if (n.length != 6 || !request.finite()) throw new IllegalArgumentException("six numbers are needed");
                tool.frame = n;
                arm.attach(tool);
                say(Text.DONE);
                return;
            case REL_VELOCITY:
                if (n.length < 1) throw new IllegalArgumentException("a number is needed");
                speed = n[0];
                say(Text.DONE);
                return;
            case TORQUES_EXTERNAL:
                say(Text.line(arm.externalTorques()));
                return;
            case TORQUES_MEASURED:
                say(Text.line(arm.measuredTorques()));
                return;
            case GET_POSE:
                say(Text.line(arm.pose()));
                return;
            case GET_FORCE:
                say(Text.line(arm.force()));
                return;
            case GET_MOMENT:
                say(Text.line(arm.moment()));
                return;
            case HAND_GUIDING:
            case PRECISE_1:
            case PRECISE_2:
                say(Text.DONE);
                return;
            case START_JOINTS:
                serve(Servo.Kind.JOINTS, soft, request, now);
                return;
            case START_POSE:
                serve(Servo.Kind.POSE, Soft.STIFF, request, now);
                return;
            case START_SPEED:
                serve(Servo.Kind.SPEED, Soft.STIFF, request, now);
                return;
            case START_IMPEDANCE:
                impedance(n, request, now);
                return;
            default:
                if (request.word.ours()) ours(request, n, now);
                else move(request, n, now);
        }
    }

    private void serve(Servo.Kind kind, Soft how, Request request, double now) {
        if (request.stops != stops) {
            say(hello ? Text.stopped("the client") : Text.NAK);
            return;
        }
        mode = Mode.SERVO;
        words.clear();
        servoEnds = false;
        say(how.kind == Soft.Kind.FLOAT ? Text.ok(Word.FLOAT) : Text.DONE);
        servo.start(kind, how, goals, now);
        tell("servo mode begins" + (how.kind == Soft.Kind.STIFF ? "" : ", " + how.kind));
    }

    /** The toolbox's own impedance mode, whose second `done` says that it has ended. */
    private void impedance(double[] n, Request request, double now) {
        if (n.length != 7 || !request.finite()) throw new IllegalArgumentException("seven numbers are needed");
        tool.tool(new double[] {n[0], n[1], n[2], n[3], 0, 0, 100, 0, 0, 0});
        arm.attach(tool);
        if (arm.mayBeSoft()) {
            serve(Servo.Kind.JOINTS, new Soft(Soft.Kind.TOOLBOX, n), request, now);
        } else {
            say(Text.DONE);
            ended("the load check refuses to be soft");
            say(Text.DONE);
        }
    }

    private void ours(Request request, double[] n, double now) {
        Word word = request.word;
        String no = null;
        switch (word) {
            case TOOL:
            case LOAD:
                no = Limits.refuse("the mass", n, 0, 1, 0, Limits.MASS);
                if (no == null) no = Limits.refuse("the centre of mass in mm", n, 1, 4, -Limits.CENTRE_MM, Limits.CENTRE_MM);
                if (no == null && word == Word.TOOL)
                    no = Limits.refuse("the tool point in mm", n, 4, 7, -Limits.TOOL_MM, Limits.TOOL_MM);
                if (no == null && word == Word.TOOL) no = Limits.refuse("an angle", n, 7, 10, -2 * Math.PI, 2 * Math.PI);
                if (no == null) weigh(word, n);
                else say(Text.no(word, no));
                return;
            case SOFT_JOINTS:
            case SOFT_TOOL:
                Soft wanted = new Soft(word == Word.SOFT_JOINTS ? Soft.Kind.JOINTS : Soft.Kind.TOOL, n);
                no = wanted.refusal();
                if (no == null) no = softRefusal();
                if (no == null) soft = wanted;
                break;
            case STIFF:
                soft = Soft.STIFF;
                break;
            case FLOAT:
                no = softRefusal();
                if (no == null) {
                    serve(Servo.Kind.JOINTS, new Soft(Soft.Kind.FLOAT, null), request, now);
                    return;
                }
                break;
            default:
                say(Text.ok(word));
                begin(new Motion(Motion.Kind.GUIDE, null, null, 1), request, false, now);
                return;
        }
        say(no == null ? Text.ok(word, n) : Text.no(word, no));
    }

    private void weigh(Word word, double[] n) {
        ToolData tried = tool.copy();
        if (word == Word.TOOL) tried.tool(n);
        else tried.load(n);
        String no = tried.refusal();
        if (no != null) {
            say(Text.no(word, no));
            return;
        }
        if (word == Word.TOOL) tool.tool(n);
        else tool.load(n);
        say(Text.ok(word, arm.attach(tool)));
    }

    private String softRefusal() {
        if (!tool.known) return "the tool's mass is not known: say " + Word.TOOL.text + " first";
        return arm.mayBeSoft() ? null : "the controller's load check fails: mass, centre or pose are wrong";
    }

    private void move(Request request, double[] n, double now) {
        boolean guarded = request.word.most > 0;
        if (guarded && (n.length % 3 != 0 || n.length > 21 || !request.finite()))
            throw new IllegalArgumentException("triples of joint, lowest and highest torque are needed");
        double[] target = new double[6];
        Motion made;
        switch (request.word) {
            case LINE:
            case GUARDED_LINE:
                copy(stored, target);
                made = new Motion(Motion.Kind.LINE, target, null, speed);
                break;
            case LINE_BASE:
            case LINE_TOOL:
                copy(stored, target);
                target = Motion.moved(arm.pose(), target, request.word == Word.LINE_TOOL);
                made = new Motion(Motion.Kind.LINE, target, null, speed);
                break;
            case CIRCLE:
            case GUARDED_CIRCLE:
                double[] through = new double[6];
                copy(via, through);
                copy(end, target);
                made = new Motion(Motion.Kind.CIRCLE, target, through, speed);
                break;
            default:
                target = new double[7];
                goals.joints(target);
                made = new Motion(Motion.Kind.JOINTS, target, null, speed);
        }
        if (guarded) made.guard = n;
        say(Text.DONE);
        begin(made, request, guarded, now);
    }

    private static void copy(double[] from, double[] to) {
        synchronized (from) {
            System.arraycopy(from, 0, to, 0, 6);
        }
    }

    /** Begins a motion whose first word is said. */
    private void begin(Motion made, Request request, boolean guarded, double now) {
        mode = Mode.MOTION;
        words.clear();
        kept = null;
        keeps = guarded && !hello; // who said hello gets a refusal, or asks again
        motion = made;
        motion.contact = hello ? contact : null;
        ending = request.stops != stops ? "the client" : null;
        boolean still = guarded && motion.guard.length == 0;
        String no = ending != null || still ? ending : motion.refusal();
        if (no == null && !still) no = started();
        refused = no != null;
        if (refused) log.info("a motion is refused: " + no);
        if (still) motion = null;
        lastWordDue = now + (refused ? REFUSAL : LAST_WORD);
    }

    private String started() {
        try {
            arm.start(motion);
            return null;
        } catch (RuntimeException error) {
            return String.valueOf(error.getMessage());
        }
    }

    private void moving(Demand wanted, String halt, double now) {
        boolean runs = motion != null && !refused;
        if (halt != null && (ending == null || ending.isEmpty())) stopMotion(halt, now);
        else if (wanted == Demand.PAUSE && runs && ending == null) stopMotion("", now);
        if (runs && !arm.finished()) {
            if (ending != null && now - cancelled > CANCEL_AGAIN) stopMotion(ending, now);
            return;
        }
        if (now < lastWordDue) return;
        if (runs && ending != null && ending.isEmpty() && arm.broken() == null && arm.error() == null) {
            mode = Mode.PAUSED;
            tell("the motion is paused");
            return;
        }
        finish(runs);
    }

    private void stopMotion(String why, double now) {
        ending = why;
        cancelled = now;
        if (motion == null || refused) return;
        try {
            arm.cancel();
        } catch (RuntimeException error) {
            log.info("the motion does not stop in order, and is asked again: " + error);
        }
    }

    private void finish(boolean runs) {
        String broken = runs ? arm.broken() : null;
        String error = runs ? arm.error() : null;
        boolean bad = refused || error != null;
        String last = Text.DONE;
        if (ending != null && !ending.isEmpty()) last = hello ? Text.stopped(ending) : Text.NAK;
        else if (bad) last = Text.NAK;
        else if (broken != null && hello) last = Text.stopped("contact, " + broken);
        else if (runs && motion.guard != null && !arrived()) last = Text.INTERRUPTED;
        if (ending != null && !ending.isEmpty()) tell("the motion was stopped by " + ending);
        else if (error != null) tell("the controller gave the motion up: " + error);
        else if (broken != null) tell("contact: " + broken);
        Request next = keeps && !bad ? kept : null;
        settle();
        say(last);
        if (last.equals(Text.NAK)) forgetTool();
        if (next != null) words.offer(next);
    }

    private boolean arrived() {
        if (motion.kind == Motion.Kind.JOINTS) {
            double[] joints = new double[7];
            arm.joints(joints);
            for (int i = 0; i < 7; i++)
                if (Math.abs(joints[i] - motion.target[i]) > Math.toRadians(0.1)) return false;
            return true;
        }
        double[] pose = arm.pose();
        for (int i = 0; i < 3; i++)
            if (Math.abs(pose[i] - motion.target[i]) > 0.2) return false;
        return true;
    }

    private void paused(Demand wanted, String halt, double now) {
        if (halt != null || wanted == Demand.CANCEL) {
            ending = halt != null ? halt : "a cancel";
            finish(false);
        } else if (wanted == Demand.RESUME) {
            ending = null;
            mode = Mode.MOTION;
            String no = started();
            refused = no != null;
            lastWordDue = now + LAST_WORD;
            tell(no == null ? "the motion is resumed" : "the motion is not resumed: " + no);
        }
    }

    private void serving(Demand wanted, String halt, double now) {
        Watchdog.Verdict verdict = hello ? watchdog.judge(now - beat) : Watchdog.Verdict.ALIVE;
        boolean tooLate = verdict == Watchdog.Verdict.END || verdict == Watchdog.Verdict.BRAKE && !servo.holds();
        if (servoEnds || halt != null || tooLate) {
            endServo(halt != null ? halt : tooLate ? "the watchdog" : "the client's word");
            return;
        }
        if (mode == Mode.SERVO && (verdict == Watchdog.Verdict.BRAKE || wanted == Demand.PAUSE)) {
            if (!servo.holds()) {
                endServo("a pause");
                return;
            }
            servo.brake();
            held = wanted == Demand.PAUSE ? "paused" : "the client was silent";
            mode = Mode.HELD;
            tell("the arm brakes and holds: " + held);
        } else if (mode == Mode.HELD && wanted == Demand.RESUME) {
            if (servo.resume(goals, now)) {
                mode = Mode.SERVO;
                tell("servo mode continues");
            } else {
                demand.compareAndSet(Demand.NONE, Demand.RESUME);
            }
        }
        String no = servo.step(goals, now);
        if (no != null) endServo(no);
    }

    private void endServo(String why) {
        boolean toolbox = servo.soft.kind == Soft.Kind.TOOLBOX;
        servo.stop();
        settle();
        ended(why);
        if (toolbox) say(Text.DONE);
    }

    private void ended(String why) { tell("servo mode ends: " + why); }
}
