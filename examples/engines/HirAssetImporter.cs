// Light and specular of exported assets in Unity 6 with glTFast 6.9; goes into Assets/Editor. Not run by hir's tests: docs/engines/unity.md.
// The .glb of profile `unity-legacy` carries specular-glossiness, which glTFast turns into a material of the specular workflow by itself.
using System.IO;
using System.Text;
using UnityEditor;
using UnityEngine;
using UnityEngine.Rendering;

namespace Hir
{
    /// Imports the .hdr beside a .glb or .gltf of hir as an uncompressed panorama, its pixels as they are. Other .hdr files keep
    /// the project's settings.
    public sealed class HirLightImporter : AssetPostprocessor
    {
        void OnPreprocessTexture()
        {
            if (!IsLightOfExport(assetPath)) return;
            var importer = (TextureImporter)assetImporter;
            importer.textureShape = TextureImporterShape.Texture2D; // Skybox/Panoramic samples the panorama itself
            importer.sRGBTexture = false;
            importer.mipmapEnabled = false;
            importer.wrapModeU = TextureWrapMode.Repeat;
            importer.wrapModeV = TextureWrapMode.Clamp;
            importer.textureCompression = TextureImporterCompression.Uncompressed;
            importer.npotScale = TextureImporterNPOTScale.None;
        }

        static bool IsLightOfExport(string path)
        {
            if (!path.EndsWith(".hdr")) return false;
            foreach (var suffix in new[] { ".glb", ".gltf" })
            {
                var model = Path.ChangeExtension(path, suffix);
                if (File.Exists(model) && Json(model).Contains("hir_exporters")) return true; // its "generator"
            }
            return false;
        }

        /// The JSON of a glTF file; that of a .glb is its first chunk.
        static string Json(string model)
        {
            if (model.EndsWith(".gltf")) return File.ReadAllText(model);
            using var reader = new BinaryReader(File.OpenRead(model));
            reader.BaseStream.Seek(12, SeekOrigin.Begin);
            var length = reader.ReadInt32();
            reader.ReadInt32();
            return Encoding.UTF8.GetString(reader.ReadBytes(length));
        }
    }

    public static class HirLight
    {
        // glTFast turns the file's +X to Unity's -X. Skybox/Panoramic has Unity's +X in its middle, the image +Z: a quarter turn.
        const float Rotation = 90f;

        [MenuItem("hir/Light the scene with the selected .hdr")]
        static void Apply()
        {
            var panorama = Selection.activeObject as Texture2D;
            if (panorama == null)
            {
                EditorUtility.DisplayDialog("hir", "Select an imported .hdr first.", "OK");
                return;
            }
            var sky = new Material(Shader.Find("Skybox/Panoramic"));
            sky.SetTexture("_MainTex", panorama);
            sky.SetFloat("_Mapping", 1f);   // latitude longitude
            sky.SetFloat("_ImageType", 0f); // 360 degrees
            sky.SetFloat("_Rotation", Rotation);
            sky.SetFloat("_Exposure", 1f);
            AssetDatabase.CreateAsset(sky, AssetDatabase.GenerateUniqueAssetPath(
                Path.ChangeExtension(AssetDatabase.GetAssetPath(panorama), ".sky.mat")));
            RenderSettings.skybox = sky;
            RenderSettings.ambientMode = AmbientMode.Skybox;
            RenderSettings.ambientIntensity = 1f;
            RenderSettings.defaultReflectionMode = DefaultReflectionMode.Skybox;
            RenderSettings.reflectionIntensity = 1f;
            DynamicGI.UpdateEnvironment();
        }
    }
}
