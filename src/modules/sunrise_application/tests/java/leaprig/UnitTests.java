package leaprig;

import static leaprig.Bench.check;
import static leaprig.Bench.equal;

import java.lang.management.ManagementFactory;
import java.lang.reflect.InvocationTargetException;
import java.lang.reflect.Method;
import java.util.Random;

/** Parser, watchdog, brake and session, in time that is handed in. Each public method is a test; main runs them all. */
public final class UnitTests {
    private static final String HOME = "jp_-0.78540_0.52360_0.00000_-1.39626_0.00000_1.22173_0.00000_";
    private static final String NEAR = "0.02_0.02_0.02_0.02_0.02_0.02_0.02_";

    public static void main(String[] names) throws Exception {
        int failed = 0;
        int ran = 0;
        for (Method test : UnitTests.class.getDeclaredMethods()) {
            if (test.getParameterTypes().length > 0 || test.getReturnType() != void.class) continue;
            ran++;
            try {
                test.invoke(new UnitTests());
                System.out.println("ok " + test.getName());
            } catch (InvocationTargetException error) {
                failed++;
                System.out.println("FAILED " + test.getName());
                error.getCause().printStackTrace(System.out);
            }
        }
        System.out.println(ran + " tests, " + failed + " failed");
        System.exit(failed == 0 && ran > 0 ? 0 : 1);
    }

    private static Request read(String line) {
        Request request = new Request();
        request.read(line);
        return request;
    }

    public void everyWordIsReadByItsOwnText() {
        for (Word word : Word.values()) {
            equal(word, read(word.text).word);
            if (word.kind == Word.Kind.MAIN_EXACT || word.ours()) check(read(word.text + "x").word != word, word.text);
            else equal(word, read(word.text + "_1_").word);
        }
        check(read("noSuchCommand").word == null && read("").word == null && read("Eef_pos_").word == null, "unknown");
        equal(Word.TOOL, read("lrTool_1_").word);
    }

    public void numbersAreReadAsJavaReadsThem() {
        Request request = read("jp_-0.5_1e-3_ 2 _NaN_Infinity_0x1p3__7d");
        equal(7, request.count);
        equal(-0.5, request.numbers[0]);
        equal(8.0, request.numbers[5]);
        equal(7.0, request.numbers[6]);
        check(request.fault == null && !request.finite(), "accepted, as by the toolbox");
        equal("a number is not finite", request.refusal());
        equal("a number is not finite", read("jp_1_2_3_4_5_6_-Infinity").refusal());
        equal(0, read("doPTPinJS_1_2_").count);
        equal(1, read("jp_1").count);
    }

    public void whatIsNoNumberIsSaid() {
        for (String bad : new String[] {"nan", "inf", "1,5", "x", "--1", "1e", "é"})
            equal("field 2 is not a number", read("jp_0_" + bad + "_0_").fault);
        StringBuilder many = new StringBuilder("jp_");
        for (int i = 0; i <= Request.MOST; i++) many.append("1_");
        equal("more than 32 numbers", read(many.toString()).refusal());
        StringBuilder digits = new StringBuilder("jp_");
        for (int i = 0; i < 65; i++) digits.append('1');
        equal("field 1 is not a number", read(digits.toString()).refusal());
        equal("2 numbers came, 7 are needed", read("jp_0_0_").refusal());
        equal("8 numbers came, 7 are needed", read("jp_0_0_0_0_0_0_0_0_").refusal());
        equal("22 numbers came, 0 to 21 are needed", read("doPTP!inJS" + ONES_22).refusal());
        check(read("jp_" + NEAR).refusal() == null, "seven are right");
    }

    private static final String ONES_22 = "_1_1_1_1_1_1_1_1_1_1_1_1_1_1_1_1_1_1_1_1_1_1";

    public void linesEndWithLineFeedOrReturnAndLongOnesAreDropped() {
        Lines lines = new Lines();
        equal("a", feed(lines, "a\n"));
        equal("b|c", feed(lines, "b\r\n\nc\r"));
        StringBuilder text = new StringBuilder();
        for (int i = 0; i < Lines.LONGEST; i++) text.append('x');
        equal(text.toString(), feed(lines, text + "\n"));
        equal("end", feed(lines, text + "x\nend\n"));
    }

    private static String feed(Lines lines, String text) {
        StringBuilder all = new StringBuilder();
        for (int i = 0; i < text.length(); i++) {
            String line = lines.take(text.charAt(i));
            if (line != null) all.append(all.length() > 0 ? "|" : "").append(line);
        }
        return all.toString();
    }

    public void fieldsOfAnswersHoldNoSeparatorAndNoStrangeLetter() {
        equal("a b c", Text.plain("a_b\u00e9c"));
        equal(200, Text.plain(new String(new char[300]).replace('\0', 'x')).length());
        equal("1.0E-4_-0.0_\n", Text.line(new double[] {1e-4, -0.0}));
    }

    public void theWatchdogJudgesSilence() {
        Watchdog dog = new Watchdog();
        equal(Watchdog.Verdict.ALIVE, dog.judge(0.2));
        equal(Watchdog.Verdict.BRAKE, dog.judge(0.2001));
        equal(Watchdog.Verdict.END, dog.judge(10.001));
        check(dog.set(0.04, 10) != null && dog.set(Double.NaN, 10) != null && dog.set(2.1, 10) != null, "first time");
        check(dog.set(1, 1) != null && dog.set(1, 61) != null && dog.set(1, Double.NaN) != null, "second time");
        equal(0.2, dog.brake());
        check(dog.set(0.05, 60) == null && dog.brake() == 0.05 && dog.end() == 60, "both are set");
        dog.reset();
        equal(10.0, dog.end());
    }

    public void theBrakeStopsWithinItsDecelerationFromAnySpeed() {
        Random random = new Random(1);
        for (int round = 0; round < 200; round++) {
            Brake brake = new Brake();
            double[] v = new double[7], q = new double[7], to = new double[7];
            double fastest = 0;
            for (int i = 0; i < 7; i++) {
                v[i] = random.nextDouble() * 3.4 - 1.7;
                fastest = Math.max(fastest, Math.abs(v[i]));
            }
            int notes = 2 + random.nextInt(40);
            for (int k = 0; k < notes; k++) {
                for (int i = 0; i < 7; i++) q[i] = v[i] * k * 0.001;
                brake.note(q, k * 0.001);
            }
            brake.begin();
            double time = 0;
            double[] before = q.clone(), was = v.clone();
            while (!brake.resting()) {
                double dt = 0.0005 + 0.002 * random.nextDouble();
                brake.advance(dt, to);
                time += dt;
                for (int i = 0; i < 7; i++) {
                    double now = (to[i] - before[i]) / dt;
                    check(Math.abs(now) <= Math.abs(was[i]) + 1e-9, "it never gets faster");
                    was[i] = now;
                    before[i] = to[i];
                }
            }
            check(time <= fastest / Brake.DECELERATION + 0.0025, "in time");
            for (int i = 0; i < 7; i++)
                equal(Math.round(1e9 * (q[i] + 0.5 * v[i] * fastest / Brake.DECELERATION)), Math.round(1e9 * to[i]));
            brake.advance(0, to);
            check(Limits.outside(to) < 0, "no time changes nothing");
        }
    }

    public void theBrakeOfAnArmJustSeenStandsStill() {
        Brake brake = new Brake();
        brake.note(new double[] {1, 0, 0, 0, 0, 0, 0}, 5);
        brake.begin();
        double[] to = new double[7];
        brake.advance(0.001, to);
        check(brake.resting() && to[0] == 1, "nothing is known of its speed");
    }

    public void theServoLawIsThatOfThePublishedServer() {
        equal(0.0, Servo.law(0));
        check(Math.abs(Servo.law(0.0525) - 0.07 * (1 - Math.exp(-1))) < 1e-12, "at its width");
        check(Math.abs(Servo.law(-3) + 0.07) < 1e-12, "at most 0.07 rad");
    }

    public void linesAreMovedInTheAxesOfBaseAndTool() {
        double[] pose = {100, 200, 300, Math.PI / 2, 0, 0};
        double[] way = {10, 0, 5, 0, 0, 0};
        equal(110.0, Motion.moved(pose, way, false)[0]);
        double[] to = Motion.moved(pose, way, true);
        check(Math.abs(to[0] - 100) < 1e-9 && Math.abs(to[1] - 210) < 1e-9 && Math.abs(to[2] - 305) < 1e-9, "turned");
        double[] turned = {1, 2, 3, 0.3, -0.7, 2};
        for (int axis = 0; axis < 3; axis++) {
            way = new double[6];
            way[axis] = 10;
            double[] one = Motion.moved(turned, way, true);
            way[axis] = 0;
            way[(axis + 1) % 3] = 10;
            double[] next = Motion.moved(turned, way, true);
            double along = 0, across = 0;
            for (int i = 0; i < 3; i++) {
                along += (one[i] - turned[i]) * (one[i] - turned[i]);
                across += (one[i] - turned[i]) * (next[i] - turned[i]);
            }
            check(Math.abs(along - 100) < 1e-9 && Math.abs(across) < 1e-9, "a rotation keeps lengths and right angles");
        }
    }

    public void anOldClientSeesTheToolboxAlone() {
        Bench bench = new Bench();
        equal("", bench.ask("noSuchCommand"));
        equal("nak\n", bench.ask("jRelVel_abc_"));
        equal("done\n", bench.ask("jRelVel_0.25_"));
        for (Word word : Word.values())
            if (word.ours() && word != Word.HELLO && word != Word.STOP) equal("", bench.ask(word.text + "_1_1_1_1_1_1_1_"));
        equal("done\n", bench.ask("jp_0.1_0.2_"));
        equal("", bench.ask("jp_nan_0_"));
        equal("done\n", bench.ask("jp_NaN_0_"));
        equal("1\n\n", bench.ask("getPin3"));
        equal("done\n", bench.ask("blueOn"));
        equal("0.0_0.0_0.0_0.0_0.0_0.0_0.0_\n", bench.ask("getJointsPositions"));
        equal("500.0_0.0_500.0_0.0_0.0_0.0_\n", bench.ask("Eef_pos"));
        equal("done\n", bench.ask("handGuiding"));
        equal("", bench.ask("DcSeCarJP_0_0_0_0_0_0_0_"));
        equal("", bench.ask("lrHello_x_"));
    }

    public void aMotionSaysTwoWordsApart() {
        Bench bench = new Bench();
        bench.ask("jRelVel_0.25_");
        bench.ask(HOME);
        equal("done\n", bench.ask("doPTPinJS"));
        equal("", bench.ask("Eef_pos"));
        equal("0.0_0.0_0.0_0.0_0.0_0.0_0.0_\n", bench.ask("getJointsPositions"));
        equal("done\n", bench.ask("stopDirectServoJoints"));
        bench.run(1.1);
        equal("done\n", bench.client.take());
        equal("-0.7854_0.5236_0.0_-1.39626_0.0_1.22173_0.0_\n", bench.ask("getJointsPositions"));
    }

    public void aMotionThatCannotBeIsRefusedLater() {
        String[][] bad = {
            {"jRelVel_0.0_", HOME, "doPTPinJS"}, {"jRelVel_0.5_", "jp_3.2_0_0_0_0_0_0_", "doPTPinJS"},
            {"jRelVel_NaN_", HOME, "doPTPinJS"}, {"jRelVel_0.5_", "jp_NaN_0_0_0_0_0_0_", "doPTPinJS"},
            {"jRelVel_50_", "cArtixanPosition_NaN_0_0_0_0_0_", "doPTPinCS"},
            {"jRelVel_-1_", "cArtixanPosition_1_0_0_0_0_0_", "doPTPinCSRelBase"},
            {"jRelVel_0.5_", HOME, "doPTP!inJS_7_-10_10_"},
        };
        for (String[] lines : bad) {
            Bench bench = new Bench();
            bench.ask(lines[0]);
            bench.ask(lines[1]);
            equal("done\n", bench.ask(lines[2]));
            bench.run(0.048);
            equal("", bench.client.take());
            bench.run(0.01);
            equal("nak\n", bench.client.take());
            check(bench.arm.motion == null, "nothing moved");
        }
    }

    public void whatTheControllerRefusesIsRefused() {
        Bench bench = new Bench();
        bench.arm.throwsAtStart = true;
        bench.ask("TFtrans_0_0_100_0_0_0_");
        equal("done\n", bench.ask("doPTPinJS"));
        bench.run(0.1);
        equal("nak\n", bench.client.take());
        equal("attach 0.0", bench.arm.calls.get(bench.arm.calls.size() - 1));
        bench.arm.throwsAtStart = false;
        bench.ask("doPTPinJS");
        bench.arm.failed = "it gave up";
        bench.run(0.1);
        equal("nak\n", bench.client.take());
    }

    public void toolFramesNeedSixFiniteNumbers() {
        Bench bench = new Bench();
        for (String line : new String[] {"TFtrans_1_", "TFtrans_1_2_3_4_5_6_7_", "TFtrans_a", "TFtrans_0_0_NaN_0_0_0_"})
            equal("nak\n", bench.ask(line));
        equal("done\n", bench.ask("TFtrans_0_0_100_0_0_0"));
    }

    public void aGuardedMotionIsInterruptedAndKeepsTheLastWord() {
        Bench bench = new Bench();
        bench.ask(HOME);
        for (String bad : new String[] {"_0_-10_", "_0_NaN_10_", ONES_22 + "_1_1_"}) equal("nak\n", bench.ask("doPTP!inJS" + bad));
        equal("done\n", bench.ask("doPTP!inJS"));
        bench.run(0.1);
        equal("done\n", bench.client.take());
        equal("done\n", bench.ask("doPTP!inJS_0_-10_10_"));
        equal("", bench.ask("Torques_ext_J"));
        bench.arm.torques[0] = 11;
        bench.run(0.1);
        equal("interrupted\n11.0_0.0_0.0_0.0_0.0_0.0_0.0_\n", bench.client.take());
        bench.arm.torques[0] = 0;
        bench.ask("doPTP!inJS_0_-10_10_");
        bench.ask("Torques_ext_J");
        bench.ask("getPin3");
        bench.run(1.1);
        equal("done\n", bench.client.take());
    }

    public void whatIsRefusedDuringAGuardedMotionDoesNotFollowIt() {
        for (String word : new String[] {"lrGuide_", "doPTPinCS", "doPTPinJS_1_", "startDirectServoJoints"}) {
            Bench bench = new Bench();
            bench.hello();
            bench.ask("lrWatchdog_2_60_");
            bench.ask("jRelVel_0.5_");
            bench.ask(HOME);
            equal("done\n", bench.ask("doPTP!inJS_0_-100_100_"));
            bench.ask(word);
            bench.run(1.1);
            equal(word + Session.Mode.IDLE, word + bench.session.mode());
        }
    }

    public void servoFollowsGoalsAndStopsByItsWord() {
        Bench bench = new Bench();
        equal("done\n", bench.ask("startDirectServoJoints"));
        equal("done\n", bench.ask("jp_" + NEAR));
        equal("", bench.ask("jf_" + NEAR));
        bench.run(3);
        check(Math.abs(bench.arm.joints[3] - 0.02) < 1e-3, "it is there");
        equal("", bench.ask("Torques_ext_J"));
        equal("done\n", bench.ask("stopDirectServoJoints"));
        equal(Session.Mode.IDLE, bench.session.mode());
        equal("0.0_0.0_0.0_\n", bench.ask("Eef_force"));
        check(!bench.arm.servoing, "stopped");
    }

    public void aGoalOfAnOldClientThatCannotBeEndsTheModeAndIsNotFollowed() {
        for (String bad : new String[] {"jp_NaN_0_0_0_0_0_0_", "jp_3.2_0_0_0_0_0_0_", "jp_Infinity_"}) {
            Bench bench = new Bench();
            bench.ask("startDirectServoJoints");
            equal("done\n", bench.ask(bad));
            check(!bench.arm.servoing && bench.arm.joints[0] == 0, bad);
            equal("done\n", bench.ask("stopDirectServoJoints"));
        }
    }

    public void eachWordOfAMotionStartsItsOwn() {
        String[][] starts = {
            {"doPTPinJS", "JOINTS"}, {"doPTP!inJS_0_-100_100_", "JOINTS"}, {"doPTPinCS", "LINE"}, {"doPTP!inCS_0_-100_100_", "LINE"},
            {"doPTPinCSRelBase", "LINE"}, {"doPTPinCSRelEEF", "LINE"},
            {"doPTPinCSCircle1", "CIRCLE"}, {"doPTP!CSCircle1_0_-100_100_", "CIRCLE"},
        };
        for (String[] each : starts) {
            Bench bench = new Bench();
            bench.ask("jRelVel_0.5_");
            bench.ask(HOME);
            equal("done\n", bench.ask(each[0]));
            check(bench.arm.calls.contains("start " + each[1]), each[0] + ": " + bench.arm.calls);
        }
    }

    public void anOldClientHasNoWatchdog() {
        Bench bench = new Bench();
        bench.ask("startDirectServoJoints");
        bench.run(30);
        check(bench.arm.servoing, "as with the published server");
    }

    public void velocitiesAreHeldForHalfASecond() {
        Bench bench = new Bench();
        equal("done\n", bench.ask("stVelDcJoint_"));
        equal("done\n", bench.ask("velJDC_0.1_0_0_0_0_0_0_"));
        bench.run(2);
        check(Math.abs(bench.arm.joints[0] - 0.05) < 0.003, "it stood after half a second: " + bench.arm.joints[0]);
        for (int i = 0; i < 400; i++) {
            bench.ask("velJDCJP_1_0_0_0_0_0_0_");
            bench.run(0.01);
        }
        check(!bench.arm.servoing && bench.arm.joints[0] <= Limits.range(0), "the range ends the mode");
    }

    public void poseServoTakesPosesAndEndsAtWhatIsNone() {
        Bench bench = new Bench();
        equal("done\n", bench.ask("stDcEEf_"));
        equal("500.0_0.0_500.0_0.0_0.0_0.0_\n", bench.ask("DcSeCarEEfP_500_0_501_0_0_0_"));
        check(bench.arm.servoing, "it runs");
        bench.ask("DcSeCarEEfP_NaN_0_501_0_0_0_");
        check(!bench.arm.servoing, "it ended");
    }

    public void theImpedanceModeOfTheToolboxSaysASecondDone() {
        Bench bench = new Bench();
        String start = "startSmartImpedneceJoints_1_0_0_50_2000_200_50_";
        equal("done\n", bench.ask(start));
        equal("done\n", bench.ask("jp_" + NEAR));
        equal("done\ndone\n", bench.ask("stopDirectServoJoints"));
        bench.arm.soft = false;
        equal("done\ndone\n", bench.ask(start));
        equal("nak\n", bench.ask("startSmartImpedneceJoints_1_"));
    }

    public void whatIsWrongIsRefusedWithAReasonAfterHello() {
        Bench bench = new Bench();
        bench.hello();
        equal("no_jp_field 1 is not a number_\n", bench.ask("jp_nan_0_0_0_0_0_0_"));
        check(bench.ask("jp_NaN_0_0_0_0_0_0_").startsWith("no_jp_a number is not finite"), "NaN");
        check(bench.ask("jp_0_0_").startsWith("no_jp_2 numbers"), "too few");
        check(bench.ask("jp_0_2.2_0_0_0_0_0_").startsWith("no_jp_joint 2 is 2.2 rad"), "range");
        equal("no_word_unknown_\n", bench.ask("noSuchCommand"));
        check(bench.ask("jRelVel_x_").startsWith("no_jRelVel_field"), "main");
        equal("ok_lrBeat_\n", bench.ask("lrBeat_"));
        check(bench.ask("lrResume_").startsWith("no_lrResume_the mode is IDLE"), "resume");
        check(bench.ask("lrChannel_1_").startsWith("no_lrChannel"), "channel");
    }

    public void silenceInServoModeBrakesWithin20MsHoldsAndEnds() {
        Bench bench = new Bench();
        bench.hello();
        bench.join();
        bench.ask("startDirectServoJoints");
        for (int i = 1; i <= 100; i++) {
            double[] q = {0.005 * i, 0, 0, 0, 0, 0, 0};
            bench.ask("jp_" + Text.line(q).trim());
            bench.run(0.008);
        }
        double silentSince = bench.now - 0.01;
        bench.second.take();
        while (bench.second.said.length() == 0) bench.run(Bench.CYCLE);
        double reaction = bench.now - silentSince - 0.2;
        check(reaction >= -0.011 && reaction <= 0.02, "braking began after " + reaction);
        equal("event_the arm brakes and holds: the client was silent_\n", bench.second.take());
        bench.run(1);
        double rest = bench.arm.joints[0];
        check(bench.ask("jp_" + NEAR).startsWith("no_jp_held"), "nothing moves until asked");
        bench.live(0.2);
        equal(rest, bench.arm.joints[0]);
        equal("ok_lrResume_\n", bench.ask("lrResume_"));
        bench.live(0.2);
        equal(Session.Mode.SERVO, bench.session.mode());
        equal(rest, bench.arm.joints[0]);
        bench.run(10.1);
        check(!bench.arm.servoing && bench.session.mode() == Session.Mode.IDLE, "it ended");
    }

    public void silenceStopsAMotion() {
        Bench bench = new Bench();
        bench.hello();
        bench.ask(HOME);
        bench.ask("doPTPinJS");
        bench.live(0.4);
        check(!bench.arm.calls.contains("cancel"), "a client that lives is not stopped");
        bench.run(0.203);
        check(bench.arm.calls.contains("cancel"), "stopped");
        bench.run(0.2);
        equal("stopped_the watchdog_\n", bench.client.take());
    }

    public void wordsThatNeitherSideNeedsAreRefusedAfterHello() {
        int found = 0;
        for (Word word : Word.values()) {
            if (!word.old()) continue;
            found++;
            Bench bench = new Bench();
            bench.hello();
            String name = word.text.endsWith("_") ? word.text.substring(0, word.text.length() - 1) : word.text;
            for (String numbers : new String[] {"", "_1_1_1_1_1_1_1_", "_x_"})
                equal("no_" + name + "_not offered to a client that says hello_\n", bench.ask(word.text + numbers));
            check(bench.arm.calls.isEmpty() && bench.session.mode() == Session.Mode.IDLE, "nothing was done: " + word);
        }
        equal(26, found);
    }

    public void theWatchdogIsSetWithinRanges() {
        Bench bench = new Bench();
        bench.hello();
        equal("ok_lrWatchdog_1.0_20.0_\n", bench.ask("lrWatchdog_1_20_"));
        check(bench.ask("lrWatchdog_9_20_").startsWith("no_lrWatchdog_the first time is 9.0 s"), "range");
    }

    public void aStopActsInTheNextCycleWhateverMoves() {
        for (String start : new String[] {"doPTPinJS", "lrGuide_"}) {
            Bench bench = new Bench();
            bench.hello();
            bench.join();
            bench.ask("jRelVel_0.5_");
            bench.ask(HOME);
            bench.ask(start);
            equal("ok_lrStop_\n", bench.second("lrStop_"));
            check(!bench.arm.calls.contains("cancel"), "not yet");
            bench.run(Bench.CYCLE);
            check(bench.arm.calls.contains("cancel"), start);
            bench.client.take();
            bench.live(FakeArm.BRAKES + 0.01);
            equal("stopped_the client_\n", bench.client.take());
        }
        for (String start : new String[] {"startDirectServoJoints", "stDcEEf_", "stVelDcJoint_"}) {
            Bench bench = new Bench();
            bench.ask(start);
            bench.session.stop();
            bench.run(Bench.CYCLE);
            check(!bench.arm.servoing && bench.session.mode() == Session.Mode.IDLE, start);
        }
    }

    public void aStopBeforeTheStartWins() {
        Bench bench = new Bench();
        bench.hello();
        Request request = new Request();
        for (String start : new String[] {"doPTPinJS", "startDirectServoJoints"}) {
            request.read(start);
            bench.session.receive(request, bench.client, bench.now);
            bench.session.stop();
            bench.live(0.2);
            check(bench.client.take().endsWith("stopped_the client_\n"), start);
            check(bench.arm.motion == null && !bench.arm.servoing, "nothing moved");
        }
    }

    public void aStopOfAnOldClientsMotionIsANak() {
        for (String start : new String[] {"doPTPinJS", "doPTPinCS", "doPTPinCSRelEEF", "doPTPinCSCircle1", "doPTP!CSCircle1_0_-100_100_"}) {
            Bench bench = new Bench();
            bench.ask("jRelVel_0.5_");
            bench.ask(HOME);
            bench.ask(start);
            bench.session.stop();
            bench.run(Bench.CYCLE);
            check(bench.arm.calls.contains("cancel"), start);
            bench.run(0.2);
            equal("nak\n", bench.client.take());
        }
    }

    public void motionsPauseResumeAndAreCancelled() {
        Bench bench = new Bench();
        bench.hello();
        bench.join();
        bench.ask(HOME);
        bench.ask("doPTPinJS");
        equal("ok_lrPause_\n", bench.second("lrPause_"));
        bench.live(0.3);
        equal(Session.Mode.PAUSED, bench.session.mode());
        equal("", bench.client.take());
        equal("ok_lrResume_\n", bench.second("lrResume_"));
        bench.live(0.3);
        equal(Session.Mode.MOTION, bench.session.mode());
        bench.live(1);
        equal("done\n", bench.client.take());
        bench.ask("doPTPinJS");
        bench.second("lrPause_");
        bench.live(0.3);
        equal("ok_lrCancel_\n", bench.second("lrCancel_"));
        bench.live(0.1);
        equal("stopped_a cancel_\n", bench.client.take());
        check(bench.second("lrCancel_").startsWith("no_lrCancel_the mode is IDLE"), "nothing to cancel");
    }

    public void servoPausesAndResumesWhereItStands() {
        Bench bench = new Bench();
        bench.hello();
        bench.ask("startDirectServoJoints");
        bench.ask("lrPause_");
        equal(Session.Mode.HELD, bench.session.mode());
        bench.ask("lrResume_");
        equal(Session.Mode.SERVO, bench.session.mode());
    }

    public void contactBreaksAMotionAndSaysWhat() {
        Bench bench = new Bench();
        bench.hello();
        equal("ok_lrContact_10.0_10.0_10.0_10.0_10.0_5.0_5.0_30.0_\n", bench.ask("lrContact_10_10_10_10_10_5_5_30_"));
        check(bench.ask("lrContact_-1_10_10_10_10_5_5_30_").startsWith("no_lrContact_a torque is -1.0"), "range");
        check(bench.ask("lrContact_1_10_10_10_10_5_5_501_").startsWith("no_lrContact_the force"), "range");
        bench.ask("doPTPinJS");
        bench.arm.torques[5] = -6;
        bench.run(0.1);
        equal("stopped_contact, joint 6_\n", bench.client.take());
        bench.arm.torques[5] = 0;
        bench.ask("doPTPinJS");
        bench.arm.force = 31;
        bench.run(0.1);
        equal("stopped_contact, force_\n", bench.client.take());
    }

    public void toolAndLoadAreOneMassAndSaidBack() {
        Bench bench = new Bench();
        bench.hello();
        equal("ok_lrTool_1.0_0.0_0.0_60.0_\n", bench.ask("lrTool_1_0_0_60_0_0_106_0_0_0_"));
        equal("ok_lrLoad_1.5_0.0_0.0_100.0_\n", bench.ask("lrLoad_0.5_0_0_180_"));
        equal("done\n", bench.ask("TFtrans_0_0_90_0_0_0_"));
        equal("attach 1.5", bench.arm.calls.get(bench.arm.calls.size() - 1));
        for (String bad : new String[] {"lrTool_15_0_0_0_0_0_0_0_0_0_", "lrTool_1_600_0_0_0_0_0_0_0_0_",
            "lrTool_1_0_0_0_0_0_2000_0_0_0_", "lrTool_1_0_0_0_0_0_0_7_0_0_", "lrLoad_13.5_0_0_0_", "lrLoad_-1_0_0_0_"})
            check(bench.ask(bad).startsWith("no_lr"), bad);
        equal("attach 1.5", bench.arm.calls.get(bench.arm.calls.size() - 1));
        bench.ask("startDirectServoJoints");
        check(bench.ask("lrTool_1_0_0_60_0_0_106_0_0_0_").startsWith("no_lrTool_the arm is not at rest"), "at rest");
    }

    public void aSoftArmIsSentTheGoalItselfAndAStiffOneByTheLaw() {
        for (Soft how : new Soft[] {Soft.STIFF, new Soft(Soft.Kind.JOINTS, null)}) {
            FakeArm arm = new FakeArm();
            Servo servo = new Servo(arm);
            Goals goals = new Goals();
            servo.start(Servo.Kind.JOINTS, how, goals, 1);
            goals.setJoints(new double[] {0.02}, 1);
            check(servo.step(goals, 1.001) == null, "it can be followed");
            equal(how == Soft.STIFF ? Servo.law(0.02) : 0.02, arm.joints[0]);
        }
    }

    public void nothingOnTheFlangeHasItsCentreThere() { equal(0.0, new ToolData().centre()[2]); }

    public void softNeedsAToolOfKnownMassAndTheLoadCheck() {
        Bench bench = new Bench();
        bench.hello();
        String joints = "lrSoftJoints_300_300_300_300_200_100_50_0.7_";
        check(bench.ask(joints).startsWith("no_lrSoftJoints_the tool's mass is not known"), "mass");
        check(bench.ask("lrFloat_").startsWith("no_lrFloat_the tool's mass"), "mass");
        bench.ask("lrTool_1_0_0_60_0_0_106_0_0_0_");
        bench.arm.soft = false;
        check(bench.ask(joints).startsWith("no_lrSoftJoints_the controller's load check"), "check");
        bench.arm.soft = true;
        check(bench.ask("lrSoftJoints_6000_0_0_0_0_0_0_0.7_").startsWith("no_lrSoftJoints_a joint's stiffness"), "range");
        check(bench.ask("lrSoftJoints_1_0_0_0_0_0_0_0_").startsWith("no_lrSoftJoints_the damping"), "range");
        check(bench.ask("lrSoftTool_1_1_1_301_1_1_0.7_1_10_5_50_0.5_").startsWith("no_lrSoftTool_a stiffness about"), "range");
        check(bench.ask("lrSoftTool_1_1_1_300_1_1_0.7_1_10_5_50_3_").startsWith("no_lrSoftTool_the path"), "range");
        String tool = "lrSoftTool_2000_2000_500_200_200_200_0.7_50_40_10_50_0.5_";
        check(bench.ask(tool).startsWith("ok_lrSoftTool_2000.0_"), "tool");
        equal("done\n", bench.ask("startDirectServoJoints"));
        check(bench.arm.calls.contains("servo TOOL"), "soft");
        check(bench.ask("lrStiff_").startsWith("no_lrStiff_the arm is not at rest"), "at rest");
        bench.ask("stopDirectServoJoints");
        check(bench.ask(joints).startsWith("ok_"), "joints");
        equal("ok_lrStiff_\n", bench.ask("lrStiff_"));
        bench.ask("startDirectServoJoints");
        equal("servo STIFF", bench.arm.calls.get(bench.arm.calls.size() - 1));
    }

    public void aFloatingArmHoldsWhenItsClientIsSilent() {
        Bench bench = new Bench();
        bench.hello();
        bench.ask("lrTool_1_0_0_60_0_0_106_0_0_0_");
        equal("ok_lrFloat_\n", bench.ask("lrFloat_"));
        bench.arm.joints[2] = 0.3;
        bench.live(0.1);
        equal(0.3, bench.arm.joints[2]);
        bench.run(0.25);
        check(!bench.arm.servoing, "it is stiff again");
    }

    public void guidingByHandIsAMotion() {
        Bench bench = new Bench();
        bench.hello();
        bench.arm.lasts = 3;
        equal("ok_lrGuide_\n", bench.ask("lrGuide_"));
        bench.live(3.1);
        equal("done\n", bench.client.take());
    }

    public void theStateIsOneAnswer() {
        Bench bench = new Bench();
        bench.hello();
        bench.live(0.3);
        String[] fields = bench.ask("lrState_").split("_");
        equal(1 + 1 + 21 + 6 + 1 + 3, fields.length - 1);
        equal("state", fields[0]);
        equal("IDLE", fields[1]);
        check(Double.parseDouble(fields[29]) < 1.5, "the cycle took " + fields[29]);
        equal("T1", fields[30]);
        bench.ask("startDirectServoJoints");
        check(bench.ask("jpState_" + NEAR).startsWith("state_SERVO_"), "with a goal");
        bench.live(1);
        check(bench.arm.joints[0] > 0.01, "the goal was taken");
        check(bench.second("lrState_").startsWith("state_SERVO_"), "on the second connection");
        check(bench.second("getPin3").startsWith("no_getPin3"), "and nothing else there");
        check(bench.second("x").startsWith("no_word"), "nor that");
    }

    public void aSafetyStopEndsWhatMoves() {
        Bench bench = new Bench();
        bench.hello();
        bench.ask("doPTPinJS");
        bench.arm.stop = "STOP1";
        bench.run(0.2);
        equal("stopped_a safety stop, STOP1_\n", bench.client.take());
        bench.arm.stop = "NOSTOP";
        bench.ask("startDirectServoJoints");
        bench.arm.stop = "STOP1";
        bench.run(0.02);
        check(!bench.arm.servoing, "ended");
    }

    public void whatTheControllerThrowsEndsWhatRunsAndNotTheSession() {
        Bench bench = new Bench();
        bench.ask("startDirectServoJoints");
        bench.arm.throwsAtStop = true;
        bench.arm.throwsInServo = true;
        bench.run(0.01);
        check(!bench.arm.servoing && bench.session.mode() == Session.Mode.IDLE, "servo mode ended");
        equal("", bench.client.take());
        bench.arm.throwsAtStop = false;
        bench.ask("doPTPinJS");
        bench.arm.throwsWhenAsked = true;
        bench.run(0.01);
        equal("nak\n", bench.client.take());
        check(bench.arm.calls.contains("cancel"), "it is asked to stop");
        equal("done\n", bench.ask("jRelVel_0.5_"));
    }

    public void aCancelThatFailsIsAskedForAgain() {
        Bench bench = new Bench();
        bench.ask("doPTPinJS");
        bench.arm.throwsAtStop = true;
        bench.session.stop();
        bench.run(0.25);
        equal(Session.Mode.MOTION, bench.session.mode());
        bench.arm.throwsAtStop = false;
        bench.run(0.3);
        equal("nak\n", bench.client.take());
    }

    public void oneClientAtATimeAndTheNextAfterIt() {
        Bench bench = new Bench();
        bench.hello();
        bench.join();
        bench.ask("lrTool_1_0_0_60_0_0_106_0_0_0_");
        bench.ask("lrWatchdog_1_20_");
        bench.ask("doPTPinJS");
        Bench.Line next = new Bench.Line();
        equal("client", bench.session.admit("next", next, 2, bench.now));
        bench.session.leave(bench.client);
        check(bench.client.closed && bench.session.changing(), "it goes");
        equal("client", bench.session.admit("next", next, 2, bench.now));
        bench.run(0.2);
        check(bench.arm.calls.contains("cancel"), "what moved was stopped");
        equal("", bench.client.take());
        equal("attach 0.0", bench.arm.calls.get(bench.arm.calls.size() - 1));
        check(bench.session.admit("next", next, 2, bench.now) == null && bench.second.closed, "the next one");
        Request request = read("lrBeat_");
        check(bench.session.receive(request, next, bench.now) == null, "which has not said hello");
    }

    public void whoIsSilentForTooLongIsSentAway() {
        Bench bench = new Bench();
        bench.ask("startDirectServoJoints");
        Bench.Line next = new Bench.Line();
        bench.run(59);
        equal("client", bench.session.admit("next", next, 2, bench.now));
        check(!bench.client.closed, "an old client has a minute");
        bench.run(2);
        bench.session.admit("next", next, 2, bench.now);
        bench.run(0.01);
        check(bench.client.closed && !bench.arm.servoing, "its servo mode ends first");
        check(bench.session.admit("next", next, 2, bench.now) == null, "then the next one");
    }

    public void aMotionOfASilentOldClientEndsFirst() {
        Bench bench = new Bench();
        bench.arm.lasts = 100;
        bench.ask("doPTPinJS");
        bench.run(70);
        equal("client", bench.session.admit("next", new Bench.Line(), 2, bench.now));
        check(!bench.client.closed, "it may go on");
    }

    public void theEndOfAnOldClientStopsItsMotionWithoutAWord() {
        Bench bench = new Bench();
        bench.ask("doPTPinJS");
        equal("", bench.ask("end"));
        check(bench.client.closed, "closed");
        bench.run(0.2);
        equal("", bench.client.take());
        equal(Session.Mode.IDLE, bench.session.mode());
    }

    /** Random lines and times: nothing is thrown, and the arm is asked for nothing that FakeArm refuses. */
    public void nothingThatIsSaidCrashesIt() { Fuzz.run(20261129, 300); }

    public void theServoLoopAllocatesNothing() {
        com.sun.management.ThreadMXBean threads = (com.sun.management.ThreadMXBean) ManagementFactory.getThreadMXBean();
        for (String soft : new String[] {"lrStiff_", "lrSoftJoints_300_300_300_300_200_100_50_0.7_"}) {
            Bench bench = new Bench();
            bench.hello();
            bench.ask("lrWatchdog_2_60_");
            bench.ask("lrTool_1_0_0_60_0_0_106_0_0_0_");
            check(bench.ask(soft).startsWith("ok_"), soft);
            equal("done\n", bench.ask("startDirectServoJoints"));
            bench.run(0.5);
            long cycles = 1000, before = threads.getThreadAllocatedBytes(Thread.currentThread().getId());
            bench.run(cycles * Bench.CYCLE);
            long bytes = threads.getThreadAllocatedBytes(Thread.currentThread().getId()) - before;
            check(bench.arm.servoing && bytes < cycles, bytes + " bytes in " + cycles + " cycles");
        }
    }
}
